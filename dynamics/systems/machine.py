"""Machines: trees of links whose parts touch the ground and each other, as one contact system."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, field

import casadi as ca

from dynamics.systems.chain import Chain
from dynamics.systems.contact_rows import Cone
from dynamics.systems.contacts import Contact, Disc, HalfPlane, Pose, Shape
from dynamics.systems.pairs import EnergyBook
from dynamics.systems.parameters import ParameterTable, Signal
from dynamics.systems.planar import Link, Number
from dynamics.systems.system import ContactSystem
from dynamics.systems.timestepping import time_stepping

_GROUND = HalfPlane()


@dataclass(frozen=True, eq=False)
class Part:
    """A ``shape`` fixed to a link, in its frame, which may meet the parts of other links."""

    name: str
    link: str
    shape: Shape


@dataclass(frozen=True)
class Sphere:
    """A round part that may touch the ground: ``centre`` in its link's frame [m], ``radius`` [m].

    In the plane it is a disc.
    """

    name: str
    link: str
    centre: tuple[float, float]
    radius: float

    @property
    def shape(self) -> Disc:
        """The disc."""
        return Disc(self.radius, self.centre)


@dataclass(frozen=True, eq=False)
class Machine:
    """A tree of links, the spheres on them that may touch the ground z = 0, and what else meets.

    ``meetings`` are pairs of names, of spheres or of further ``parts``, on two links each, that may
    touch each other. The contact of two is called ``<one> on <other>``.
    """

    links: tuple[Link, ...]
    spheres: tuple[Sphere, ...]
    parts: tuple[Part, ...] = field(default=(), kw_only=True)
    meetings: tuple[tuple[str, str], ...] = field(default=(), kw_only=True)

    def __post_init__(self) -> None:
        links = [link.name for link in self.links]
        for part in (*self.spheres, *self.parts):
            if part.link not in links:
                raise ValueError(
                    f"{part.name!r} is on link {part.link!r}, which does not exist; "
                    f"choose from {', '.join(links)}"
                )
        known = {part.name: part.link for part in (*self.spheres, *self.parts)}
        for meeting in self.meetings:
            for name in meeting:
                if name not in known:
                    raise ValueError(f"{name!r} is not a part; choose from {', '.join(known)}")
            if len({known[name] for name in meeting}) == 1:
                raise ValueError(f"{' and '.join(meeting)} are on the same link and never meet")

    def chain(self, gravity: Number = 9.81) -> Chain:
        """Build the equations of motion under ``gravity`` [m/s²]."""
        return Chain(self.links, gravity)

    def contacts(
        self, chain: Chain, q: ca.SX, spheres: Collection[str] | None = None
    ) -> dict[str, Contact]:
        """Contacts at the pose ``q`` (nq, 1): of the spheres with the ground, and the meetings.

        Of ``spheres``, all by default, those named touch the ground.
        """
        parts = {part.name: part for part in (*self.spheres, *self.parts)}
        found = {}
        for sphere in self.spheres:
            if spheres is None or sphere.name in spheres:
                pose = chain.pose(q, sphere.link)
                found[sphere.name] = Contact.between(sphere.shape, pose, _GROUND, Pose.fixed())
        for one, other in self.meetings:
            a, b = parts[one], parts[other]
            found[f"{one} on {other}"] = Contact.between(
                a.shape, chain.pose(q, a.link), b.shape, chain.pose(q, b.link)
            )
        return found

    def system(
        self,
        name: str,
        parameters: ParameterTable,
        *,
        h: ca.SX | float,
        friction: ca.SX | float | None,
        spheres: Collection[str] | None = None,
        scale: float = 1.0,
        cone: Cone = "linearised",
        linearised: bool = False,
        free_step: bool = False,
    ) -> ContactSystem:
        """One step of the machine over the ground z = 0, with friction and joint limits.

        ``spheres`` are those that may touch the ground, by default all; ``friction`` None is
        frictionless; one unit of input is ``scale`` times the gear [N m]; ``cone`` is how
        friction's is written. With ``free_step`` h is a symbol and one state more. Names of
        contacts are those of :meth:`contacts`, of limits ``<joint> low`` and ``<joint> high``.
        """
        chain = self.chain()
        more = (Signal("h", "s", "step size"),) if free_step else ()
        v = ca.SX.sym("v", chain.nq)
        damping = -ca.jacobian(chain.damping(v), v)
        motors, mass, g = scale * chain.B, chain.total_mass, chain.gravity
        base, limits = ca.diag(damping)[:2], chain.limits
        joints = [chain.coordinates[i].name for i, _, _ in limits]
        names = list(self.contacts(chain, ca.SX.sym("q", chain.nq), spheres))
        inner = len(self.meetings)
        outer = ca.vertcat(ca.DM.ones(len(names) - inner, 1), ca.DM.zeros(inner, 1))

        def stacked(each: Callable[[Contact], ca.SX], q: ca.SX) -> ca.SX:
            return ca.vertcat(*map(each, self.contacts(chain, q, spheres).values()))

        def book(
            q: ca.SX, v: ca.SX, u: ca.SX, v_next: ca.SX, normal: ca.SX, tangential: ca.SX
        ) -> EnergyBook:
            contact = ca.vertcat(ca.dot(outer, tangential), ca.dot(outer, normal))
            external = contact - h * ca.vertcat(0, mass * g) - h * base * v_next[:2]
            work = h * ca.dot(v_next, motors @ u - damping @ v_next)
            return EnergyBook(chain.energy(q, v), work, chain.momentum(q, v), external)

        def left(q: ca.SX) -> ca.SX:
            low = [q[i] - lowest for i, lowest, _ in limits]
            return ca.vertcat(*low, *(highest - q[i] for i, _, highest in limits))

        return time_stepping(
            name,
            states=(*chain.coordinates, *chain.velocities, *more),
            inputs=tuple(Signal(f"u_{joint}", "1", "motor") for joint in chain.actuated),
            contacts=tuple(Signal(contact, "N s", "normal impulse") for contact in names),
            h=h,
            mass=chain.mass,
            impulse=lambda q, v, u: h * (motors @ u - chain.bias(q, v)),
            parameters=parameters,
            distance=lambda q: stacked(lambda contact: contact.phi, q),
            sliding=lambda q: stacked(lambda contact: contact.jacobians(q)[1], q),
            friction=friction,
            cone=cone,
            limits=left if limits else None,
            limit_names=tuple(f"{joint} {end}" for end in ("low", "high") for joint in joints),
            damping=damping,
            stiffness=-ca.jacobian(chain.spring(v), v),
            linearised=linearised,
            book=book,
        )
