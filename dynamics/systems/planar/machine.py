"""Machines in the plane: trees of links whose parts touch the ground and each other."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Literal, Unpack, get_args

import casadi as ca

from dynamics.systems.checks import parse_number, parse_point, require_items, require_positive, require_text
from dynamics.systems.contact_rows import Cone, limit_distances
from dynamics.systems.mechanism import WORLD, Mechanism, Multibody, PlacedShape, StepOptions, check_parts
from dynamics.systems.pairs import EnergyBalance
from dynamics.systems.parameters import ParameterTable, Signal
from dynamics.systems.planar.chain import Chain
from dynamics.systems.planar.flight import gyroscopic_impulse
from dynamics.systems.planar.links import Link, Number, Vector
from dynamics.systems.shapes import Contact, Disc, HalfPlane, Pose, Shape
from dynamics.systems.system import ContactSystem
from dynamics.systems.timestepping import time_stepping

Gyroscopic = Literal["explicit", "implicit"]
"""Treatment of Coriolis and centrifugal forces in a step: explicit, or implicit without gain of energy."""
# The ground z = 0.
_GROUND = HalfPlane()


def link_pose(chain: Chain, q: ca.SX, link: str) -> Pose:
    """Return the pose of a link, or of the world, at ``q``."""
    return Pose.fixed() if link == WORLD else chain.pose(q, link)


@dataclass(frozen=True, eq=False)
class Part:
    """A ``shape`` fixed to a link, in the link's frame, which may touch parts of other links.

    A part of the link :data:`WORLD`, such as a wall, a slope or a stair, never moves.

    Raises ``ValueError`` for an empty name and for a shape that is no :class:`Shape`.
    """

    name: str
    link: str
    shape: Shape

    def __post_init__(self) -> None:
        require_text("the name of a part", self.name)
        if not isinstance(self.shape, Shape):
            raise ValueError(f"part {self.name!r}: shape must be a Disc, Box, Capsule or HalfPlane, got {self.shape!r}")


@dataclass(frozen=True)
class Sphere:
    """A round part that may touch the ground: ``centre`` in its link's frame [m], ``radius`` [m].

    In the plane it is a disc. Raises ``ValueError`` for an empty name, an invalid centre or radius.
    """

    name: str
    link: str
    centre: tuple[float, float]
    radius: float

    def __post_init__(self) -> None:
        require_text("the name of a sphere", self.name)
        parse_point(f"sphere {self.name!r}: centre", self.centre)
        require_positive(f"sphere {self.name!r}: radius", self.radius)

    @property
    def shape(self) -> Disc:
        """The sphere as a disc in the plane."""
        return Disc(self.radius, self.centre)


@dataclass(frozen=True, eq=False)
class Machine(Multibody):
    """A machine in the plane: a tree of links, and shapes on them that may touch the ground or each other.

    ``spheres`` may touch the ground z = 0. ``collision_pairs`` are pairs of names of spheres or ``parts``
    on different links that may touch each other; one of the two may be on the :data:`WORLD`. Their
    contact is called ``<one> on <other>``. ``gravity`` [m/s²] points down, or is the acceleration
    (x, z), as on a slope.

    Raises ``ValueError`` for links that do not form a tree, and for names that are unknown or used twice.
    """

    links: tuple[Link, ...]
    spheres: tuple[Sphere, ...]
    parts: tuple[Part, ...] = field(default=(), kw_only=True)
    collision_pairs: tuple[tuple[str, str], ...] = field(default=(), kw_only=True)
    gravity: Number | Vector = field(default=9.81, kw_only=True)

    def __post_init__(self) -> None:
        require_items("links", Link, self.links)
        require_items("spheres", Sphere, self.spheres)
        require_items("parts", Part, self.parts)
        if isinstance(self.gravity, tuple):
            parse_point("gravity", self.gravity)
        else:
            parse_number("gravity", self.gravity)
        ground_parts = [(sphere.name, sphere.link) for sphere in self.spheres]
        fixed_parts = [(part.name, part.link) for part in self.parts]
        check_parts("link", self.links, ground_parts, fixed_parts, self.collision_pairs)

    @property
    def members(self) -> tuple[Link, ...]:
        """Links of the machine."""
        return self.links

    @property
    def shapes(self) -> tuple[PlacedShape, ...]:
        """Shapes of the spheres, then of the parts."""
        return tuple(PlacedShape(part.name, part.link, part.shape) for part in (*self.spheres, *self.parts))

    @cached_property
    def _chain(self) -> Chain:
        return Chain(self.links, self.gravity)

    def tree(self) -> Chain:
        """Return the equations of motion of the machine."""
        return self._chain

    def contacts(self, q: ca.SX, spheres: Collection[str] | None = None) -> dict[str, Contact]:
        """Return a mapping from names to contacts, of spheres with the ground and of collision pairs, at ``q`` (nq, 1).

        ``spheres`` are the names of the spheres that may touch the ground, by default all.
        """
        chain, contacts = self.tree(), {}
        for sphere in self.spheres:
            if spheres is None or sphere.name in spheres:
                pose = chain.pose(q, sphere.link)
                contacts[sphere.name] = Contact.between(sphere.shape, pose, _GROUND, Pose.fixed())
        for (name_a, name_b), placed_a, placed_b in self.meeting_shapes():
            poses = [link_pose(chain, q, placed.owner) for placed in (placed_a, placed_b)]
            contacts[f"{name_a} on {name_b}"] = Contact.between(placed_a.shape, poses[0], placed_b.shape, poses[1])
        return contacts

    def system(
        self,
        name: str,
        parameters: ParameterTable,
        *,
        h: ca.SX | float,
        friction: ca.SX | float | None,
        **options: Unpack[PlanarStepOptions],
    ) -> ContactSystem:
        """Return one step of the machine over the ground z = 0, with friction and joint limits.

        ``friction`` is None without friction. ``options`` are those of :class:`PlanarStepOptions`. Names
        of contacts are those of :meth:`contacts`, of limits ``<joint> low`` and ``<joint> high``.

        Raises ``ValueError`` for an unknown ``gyroscopic``.
        """
        step = _PlanarStep(self, h, friction, **options)
        spheres = None if step.spheres is None else tuple(step.spheres)
        return replace(step.system(name, parameters), machine=Mechanism(self, step.scale, spheres, step.gyroscopic))


class PlanarStepOptions(StepOptions, total=False):
    """Settings of a step in the plane, in addition to those of :class:`StepOptions`.

    ``spheres`` are the names of the spheres that may touch the ground, by default all. With ``free_step`` h is
    a symbol and the last entry of the state. ``gyroscopic`` says whether Coriolis and centrifugal forces are
    explicit, or implicit without gain of energy (:func:`~dynamics.systems.planar.flight.gyroscopic_impulse`).
    """

    spheres: Collection[str] | None
    free_step: bool
    gyroscopic: Gyroscopic


@dataclass(frozen=True, eq=False)
class _PlanarStep:
    """Forces and contacts of a machine's step; the fields are as in :meth:`Machine.system`."""

    machine: Machine
    h: ca.SX | float
    friction: ca.SX | float | None
    spheres: Collection[str] | None = None
    scale: float = 1.0
    cone: Cone = "linearised"
    linearised: bool = False
    free_step: bool = False
    gyroscopic: Gyroscopic = "explicit"

    def __post_init__(self) -> None:
        if self.gyroscopic not in get_args(Gyroscopic):
            raise ValueError(f"gyroscopic must be 'explicit' or 'implicit', got {self.gyroscopic!r}")

    @cached_property
    def _motors(self) -> ca.SX:
        """Generalised forces (nq, nu) of one unit of each input."""
        return self.scale * self.machine.tree().B

    @cached_property
    def _damping(self) -> ca.SX:
        """Damping matrix (nq, nq)."""
        chain = self.machine.tree()
        v = ca.SX.sym("v", chain.nq)
        return -ca.jacobian(chain.damping(v), v)

    @cached_property
    def _inner_contacts(self) -> set[str]:
        """Names of the contacts between two parts that both move."""
        pairs = self.machine.meeting_shapes()
        return {f"{name_a} on {name_b}" for (name_a, name_b), _, placed in pairs if placed.owner != WORLD}

    def _impulse(self, q: ca.SX, v: ca.SX, u: ca.SX) -> ca.SX:
        """Impulse of the smooth forces (nq, 1) [N s], without dampers and springs."""
        chain = self.machine.tree()
        if self.gyroscopic == "implicit":
            return self.h * (self._motors @ u - chain.weight(q)) + gyroscopic_impulse(chain, q, v, self.h)
        return self.h * (self._motors @ u - chain.bias(q, v))

    def _energy_balance(
        self, q: ca.SX, v: ca.SX, u: ca.SX, v_next: ca.SX, normal: ca.SX, tangential: ca.SX
    ) -> EnergyBalance:
        chain, h = self.machine.tree(), self.h
        weight = chain.total_mass * ca.vertcat(*chain.gravity)
        external = h * weight - h * ca.diag(self._damping)[:2] * v_next[:2]
        for i, (label, contact) in enumerate(self.machine.contacts(q, self.spheres).items()):
            if label not in self._inner_contacts:
                external += normal[i] * contact.normal + tangential[i] * contact.tangent
        work = h * ca.dot(v_next, self._motors @ u - self._damping @ v_next)
        return EnergyBalance(chain.energy(q, v), work, chain.momentum(q, v), external)

    def _stack_contacts(self, value: Callable[[Contact], ca.SX], q: ca.SX) -> ca.SX:
        return ca.vertcat(*map(value, self.machine.contacts(q, self.spheres).values()))

    def system(self, name: str, parameters: ParameterTable) -> ContactSystem:
        """Build the contact system of the step."""
        chain = self.machine.tree()
        q = ca.SX.sym("q", chain.nq)
        step_state = (Signal("h", "s", "step size"),) if self.free_step else ()
        joints = [chain.coordinates[i].name for i, _, _ in chain.limits]
        names = self.machine.contacts(q, self.spheres)
        return time_stepping(
            name,
            states=(*chain.coordinates, *chain.velocities, *step_state),
            inputs=tuple(Signal(f"u_{joint}", "1", "motor") for joint in chain.actuated),
            contacts=tuple(Signal(contact, "N s", "normal impulse") for contact in names),
            h=self.h,
            mass=chain.mass,
            impulse=self._impulse,
            parameters=parameters,
            distance=lambda q: self._stack_contacts(lambda contact: contact.phi, q),
            sliding=lambda q: self._stack_contacts(lambda contact: contact.jacobians(q)[1], q),
            friction=self.friction,
            cone=self.cone,
            limits=partial(limit_distances, chain.limits) if chain.limits else None,
            limit_names=tuple(f"{joint} {end}" for end in ("low", "high") for joint in joints),
            damping=self._damping,
            stiffness=-ca.jacobian(chain.spring(q), q),
            linearised=self.linearised,
            energy_balance=self._energy_balance,
        )


def with_implicit_forces(system: ContactSystem) -> ContactSystem:
    """Return the system with velocity-dependent forces that gain no energy, for simulation.

    The impulse :func:`~dynamics.systems.planar.flight.gyroscopic_impulse` replaces ``-h C(q, v) v``, also in
    the most exact model of the system. A system is returned unchanged if it was not built from a planar
    machine, if x does not begin with q and v, or if its velocity-dependent forces are implicit already.
    """
    mechanism = system.machine
    if mechanism is None or mechanism.gyroscopic == "implicit" or not isinstance(mechanism.machine, Machine):
        return system
    chain = mechanism.machine.tree()
    signals = (*chain.coordinates, *chain.velocities)
    if system.states[: len(signals)] != signals:
        return system
    rows = slice(chain.nq, 2 * chain.nq)
    q, v = system.x[: chain.nq], system.x[rows]
    explicit = system.h * (chain.weight(q) - chain.bias(q, v))
    force_change = explicit - gyroscopic_impulse(chain, q, v, system.h)

    def replace_forces(explicit_system: ContactSystem) -> ContactSystem:
        residual = ca.SX(explicit_system.residual)
        residual[rows] += force_change
        return replace(explicit_system, residual=residual)

    referee, build = system.referee_model, system.referee_model and system.referee_model.build
    if referee is not None and build is not None:
        referee = replace(referee, build=lambda: replace_forces(build()))
    return replace(replace_forces(system), referee_model=referee, machine=replace(mechanism, gyroscopic="implicit"))
