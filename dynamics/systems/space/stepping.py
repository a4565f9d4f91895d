"""The step of a machine in space: time stepping on the tangent space of its positions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial

import casadi as ca
import numpy as np

from dynamics.systems.checks import require_positive
from dynamics.systems.contact_rows import (
    Cone,
    ContactRows,
    ContactSpec,
    Space,
    check_cone,
    contact_rows,
    limit_distances,
)
from dynamics.systems.pairs import EnergyBalance
from dynamics.systems.parameters import ParameterTable, Signal
from dynamics.systems.space import rotation
from dynamics.systems.space.contact import JointAxes, SpatialContact, at_random_poses
from dynamics.systems.space.coupling import CoupledJoints
from dynamics.systems.space.tree import Tree
from dynamics.systems.system import ContactSystem

PYRAMID_EDGES = (4, 8)
"""Numbers of edges that a friction pyramid may have."""


@dataclass(frozen=True, eq=False)
class ContactPair:
    """A contact at a pose: its name, the axes that move the bodies A and B, and whether B is the world."""

    name: str
    contact: SpatialContact
    axes_a: JointAxes
    axes_b: JointAxes
    touches_world: bool


@dataclass(frozen=True, eq=False)
class SpatialStep:
    """Implicit time stepping in space with plastic impacts and Coulomb friction along two tangents.

    ``M(q) (v+ - v) = h (B u - C(q, v) v+ - g(q) - D v+ - K (p + h v+ - r)) + J_n' gamma + J_t' beta + J_l' nu``
    and ``q+ = q (+) h v+``, which rotates quaternions exactly and keeps their unit length; p are the positions
    of hinges and slides, r the rest positions of springs or the commands of servos. Velocity-dependent forces
    are linear in v+ and generate no energy if M is constant. For a free body ``v+ - v`` is the change of velocity of
    its centre of mass, with v taken at the previous pose ``q (-) h v``, so that momentum is conserved. The
    pairs are those of :func:`~dynamics.systems.timestepping.time_stepping`, except that the friction cone is a
    pyramid inscribed in Coulomb's cone, with 4 or 8 ``edges``:

    ``0 <= beta_k ⟂ psi + h d_k' J_t v+ >= 0``  and  ``0 <= psi ⟂ f gamma - sum beta_k >= 0``.

    If all contacts can slide only along their first tangent, or all only along their second, the
    pyramid has two edges, along this tangent.

    The state is (q, v), multipliers are impulses [N s]. Without ``inertial`` the step is independent of v and
    quasi-dynamic: ``M v+`` replaces ``M (v+ - v) + h C v+``, and servos have no inertia. Sources: Stewart and
    Trinkle, as for ``time_stepping``; Anitescu and Potra, doi 10.1023/A:1008292328909.

    ``touches`` maps a pose to its contacts. The equations of ``coupled`` hold at the end of the step.

    Raises ``ValueError`` for an unknown cone or number of edges, and for h that is not positive.
    """

    name: str
    parameters: ParameterTable
    tree: Tree
    touches: Callable[[ca.SX], list[ContactPair]]
    h: ca.SX | float
    friction: ca.SX | float | None
    coupled: CoupledJoints | None = None
    scale: float = 1.0
    cone: Cone = "linearised"
    linearised: bool = False
    edges: int = 4
    inertial: bool = True

    def __post_init__(self) -> None:
        require_positive(f"system {self.name!r}: h", self.h)
        check_cone(self.name, self.cone)
        if self.edges not in PYRAMID_EDGES:
            raise ValueError(f"system {self.name!r}: edges must be 4 or 8, got {self.edges}")

    @cached_property
    def _symbols(self) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Symbols of the state, the input, and the state at the end of the step."""
        nx, nu = self.tree.nq + self.tree.nv, len(self.tree.actuated)
        return ca.SX.sym("x", nx), ca.SX.sym("u", nu), ca.SX.sym("x_next", nx)

    @property
    def _state(self) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Position q, velocity v, and v at the end of the step."""
        nq, (x, _, x_next) = self.tree.nq, self._symbols
        return x[:nq], x[nq:], x_next[nq:]

    def system(self) -> ContactSystem:
        """Build the contact system of the step."""
        tree = self.tree
        contacts = tuple(Signal(touch.name, "N s", "normal impulse") for touch in self.touches(self._state[0]))
        ends = tuple(f"{body} {end}" for end in ("low", "high") for body, *_ in tree.limits)
        bounds = [(entry, low, high) for _, entry, _, low, high in tree.limits]
        limits = partial(limit_distances, bounds) if bounds else None
        spec = (contacts, self._distance, self._sliding, self.friction, self.cone, self.linearised, limits, ends)
        return self._build(ContactSpec(*spec, self._space))

    def _distance(self, q: ca.SX) -> ca.SX:
        return ca.vertcat(ca.SX(0, 1), *(touch.contact.phi for touch in self.touches(q)))

    def _rows(self, q: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return rows along the normals (nc, nv), and along first and second tangents (2 nc, nv), at a pose."""
        nv = self.tree.nv
        rows = [touch.contact.jacobian_rows(touch.axes_a, touch.axes_b, nv) for touch in self.touches(q)]
        normal, *tangential = (ca.vertcat(ca.SX(0, nv), *(row[k] for row in rows)) for k in range(3))
        return ca.sparsify(normal), ca.sparsify(ca.vertcat(*tangential))

    def _sliding(self, q: ca.SX) -> ca.SX:
        first, edges = self._tangents
        rows = self._rows(q)[1]
        count = len(self.touches(q))
        return rows[count * first :, :][: count * min(2, edges // 2), :]

    @cached_property
    def _tangents(self) -> tuple[int, int]:
        """Index of the first tangent along which contacts can slide, 0 or 1, and number of edges of the pyramid."""
        q, nv = self._state[0], self.tree.nv
        count = len(self.touches(q))
        tangent_rows = ca.vertsplit(self._rows(q)[1], count) if count else [ca.SX(0, nv)] * 2
        is_still = [not np.any(at_random_poses(rows)) for rows in tangent_rows]
        return int(is_still == [True, False]), 2 if any(is_still) else self.edges

    @property
    def _space(self) -> Space:
        tree, q = self.tree, self._state[0]
        displacement = ca.SX.sym("way", tree.nv)
        jacobian = ca.jacobian(tree.advance(q, displacement, centred=False), displacement)
        tangent = ca.Function("tangent", [q], [ca.substitute(jacobian, displacement, ca.SX.zeros(tree.nv))])
        return Space(tree.nv, lambda pose: self._rows(pose)[0], lambda pose: ca.SX(tangent(pose)), self._tangents[1])

    @cached_property
    def _forces(self) -> ca.SX:
        """Forces of motors, servos, springs and dampers (nv, 1), linear in the next velocity."""
        tree, (q, _, v_next) = self.tree, self._state
        motor, servo = tree.per_velocity(lambda b: b.gear), tree.per_velocity(lambda b: b.servo)
        commands = ca.SX(tree.nv, 1)
        for k, name in enumerate(tree.actuated):
            commands[tree.v_of[name]] = self._symbols[1][k]
        position_next = tree.position_of(q) + self.h * v_next
        springs = tree.per_velocity(lambda b: b.spring) * (tree.per_velocity(lambda b: b.rest) - position_next)
        return (
            self.scale * motor * commands
            + servo * (commands - position_next)
            + springs
            - tree.per_velocity(lambda b: b.damping) * v_next
        )

    @cached_property
    def _inertia(self) -> tuple[ca.SX, ca.SX]:
        """Mass matrix, and the impulse of inertia and weight (nv, 1)."""
        tree, h, (q, v, v_next) = self.tree, self.h, self._state
        M = tree.mass(q)
        if self.inertial:
            change = about_centres(tree, q, v_next) - centre_velocities(tree, q, v, h)
            return M, h * tree.inverse_dynamics(q, v, v_next, change / h, centred=True)
        is_servo = tree.per_velocity(lambda body: None if body.servo is None else 1)
        bodies = [i for i, entry in enumerate(ca.vertsplit(is_servo)) if entry.is_zero()]
        M, impulse = M[bodies, bodies], h * tree.weight(q)
        impulse[bodies] += M @ v_next[bodies]
        return M, impulse

    def _build(self, spec: ContactSpec) -> ContactSystem:
        tree, h, (q, _, v_next), (x, u, x_next) = self.tree, self.h, self._state, self._symbols
        q_next, (M, inertial_impulse) = x_next[: tree.nq], self._inertia
        rows = contact_rows(self.name, spec, q, q_next, lambda J: h * (J @ v_next), h)
        motion = inertial_impulse - h * self._forces - rows.generalised_impulse
        if self.coupled is not None:
            motion = self.coupled.constrain(motion, tree.position_of(q), v_next, h)
        return ContactSystem(
            name=self.name,
            x=x,
            u=u,
            x_next=x_next,
            lam=rows.lam,
            residual=ca.vertcat(q_next - tree.advance(q, h * v_next), motion),
            gap=rows.gap,
            states=(*tree.coordinates, *tree.velocities),
            inputs=tuple(_input(tree, motor) for motor in tree.actuated),
            contacts=rows.signals,
            h=h,
            parameters=self.parameters,
            phi=rows.phi,
            mu_per_kappa=h,
            pairs=rows.pairs,
            forces=rows.forces,
            referee_model=spec.referee_model(rows.curved, self._build),
            refinable=self.inertial,
            energy_balance=self._energy_balance(rows) if self.inertial else None,
            mass=M,
            rotating_entries=(*tree.quaternion_entries, *tree.offset_origin_entries),
        )

    def _energy_balance(self, rows: ContactRows) -> EnergyBalance:
        tree, h, (q, v, v_next) = self.tree, self.h, self._state
        touches = self.touches(q)
        normal = rows.lam[: len(touches)] if rows.forces is None else rows.forces.normal
        tangential, n = ca.SX(0, 1) if rows.forces is None else rows.forces.tangential, normal.numel()
        external = h * tree.total_mass * tree.gravity
        for i, touch in enumerate(touches):
            if touch.touches_world:
                external = external + normal[i] * touch.contact.normal
                tangents = touch.contact.tangents[self._tangents[0] :]
                for k, tangent in zip(range(i, tangential.numel(), n), tangents, strict=False):
                    external = external + tangential[k] * tangent
        extension = tree.per_velocity(lambda b: b.rest) - tree.position_of(q) - h * v_next
        springs = tree.per_velocity(lambda b: b.spring) * extension
        work = h * ca.dot(v_next, self._forces - springs)
        v_centres = about_centres(tree, q, centre_velocities(tree, q, v, h), -1)
        return EnergyBalance(tree.energy(q, v_centres), work, tree.momentum(q, v_centres), external)


def _input(tree: Tree, motor: str) -> Signal:
    body = tree.bodies[motor]
    if body.servo is None:
        return Signal(f"u_{motor}", "1", "motor")
    return Signal(f"u_{motor}", "rad" if body.joint == "hinge" else "m", "position of the servo")


def about_centres(tree: Tree, q: ca.SX, v: ca.SX, sign: int = 1) -> ca.SX:
    """Return v (nv, 1) with velocities of centres of mass in place of origins, for free bodies.

    With ``sign`` -1 convert from centres of mass to origins.
    """
    converted = ca.SX(v)
    for name, centre in tree.centres.items():
        four, spin = q[tree.q_of[name]][3:], v[tree.v_of[name]][3:]
        start = tree.v_of[name].start
        converted[start : start + 3] += sign * rotation.matrix(four) @ ca.cross(spin, centre)
    return converted


def centre_velocities(tree: Tree, q: ca.SX, v: ca.SX, h: ca.SX | float) -> ca.SX:
    """Return :func:`about_centres` of v at the previous pose ``q (-) h v``.

    A step of h ends with velocities of origins at the pose where the step started, so that the returned
    velocities of centres of mass are exact.
    """
    q_before = ca.SX(q)
    for name in tree.centres:
        four = slice(tree.q_of[name].start + 3, tree.q_of[name].stop)
        q_before[four] = rotation.integrate(q[four], -h * v[tree.v_of[name]][3:])
    return about_centres(tree, q_before, v)
