"""The step of a machine in space: time stepping on the tangent space of its positions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np

from dynamics.systems.checks import require_positive
from dynamics.systems.contact_rows import FORMS, Cone, ContactRows, ContactSpec, Space, contact_rows
from dynamics.systems.pairs import EnergyBalance
from dynamics.systems.parameters import ParameterTable, Signal
from dynamics.systems.space import rotation
from dynamics.systems.space.contact import JointAxes, SpatialContact, at_random_poses
from dynamics.systems.space.coupling import CoupledJoints
from dynamics.systems.space.tree import Tree
from dynamics.systems.system import ContactSystem

# Edges that a friction pyramid may have.
_EDGES = (4, 8)


@dataclass(frozen=True, eq=False)
class ContactPair:
    """A contact at a pose: its name, what moves A and B, and whether B is the world."""

    name: str
    contact: SpatialContact
    one: JointAxes
    other: JointAxes
    outside: bool


def spatial_step(
    name: str,
    tree: Tree,
    touches: Callable[[ca.SX], list[ContactPair]],
    parameters: ParameterTable,
    *,
    h: ca.SX | float,
    friction: ca.SX | float | None,
    edges: int,
    scale: float,
    cone: Cone,
    linearised: bool,
    inertial: bool,
    coupled: CoupledJoints | None = None,
) -> ContactSystem:
    """Implicit time stepping in space, plastic impacts, Coulomb friction with two tangents.

    ``M(q) (v+ - v) = h (B u - C(q, v) v+ - g(q) - D v+ - K (p + h v+ - r)) + J_n' gamma
    + J_t' beta + J_l' nu`` and ``q+ = q (+) h v+``, where quaternions turn exactly and stay of unit
    length, p are the positions of hinges and slides and r those where springs rest, or what servos
    are told. Velocity forces are linear in v+ and turn energy over without making any where M does
    not change. In place of ``v+ - v`` of a free body's origin stands the change of its centre of
    mass, v taken at the pose before, ``q (-) h v``, so that momentum is kept. The pairs are those
    of :func:`~dynamics.systems.timestepping.time_stepping`, but that the friction cone is a pyramid
    inscribed in Coulomb's, with 4 or 8 ``edges``:

    ``0 <= beta_k ⟂ psi + h d_k' J_t v+ >= 0``  and  ``0 <= psi ⟂ f gamma - sum beta_k >= 0``.

    A machine all of whose contacts can slide along one tangent alone has the two edges of that,
    which is the first tangent of each contact, or the second of each.

    State (q, v), contacts are impulses [N s]. Without ``inertial`` the step forgets v and is quasi-
    dynamic: ``M v+`` stands in place of ``M (v+ - v) + h C v+``, and servos have no inertia.
    Stewart and Trinkle, as there; Anitescu and Potra, doi 10.1023/A:1008292328909.

    Joints that are ``coupled`` move together at the end of the step.

    Raises ``ValueError`` for an unknown cone or number of edges, and for h that is not positive.
    """
    require_positive(f"system {name!r}: h", h)
    if cone not in FORMS:
        kinds = ", ".join(map(repr, FORMS))
        raise ValueError(f"system {name!r}: cone must be one of {kinds}, got {cone!r}")
    if edges not in _EDGES:
        raise ValueError(f"system {name!r}: edges must be 4 or 8, got {edges}")
    nq, nv, motors = tree.nq, tree.nv, tree.actuated
    x, x_next = ca.SX.sym("x", nq + nv), ca.SX.sym("x_next", nq + nv)
    q, v, q_next, v_next = x[:nq], x[nq:], x_next[:nq], x_next[nq:]
    u = ca.SX.sym("u", len(motors))
    names = [touch.name for touch in touches(q)]
    contacts = tuple(Signal(contact_name, "N s", "normal impulse") for contact_name in names)
    limits = tree.limits
    displacement = ca.SX.sym("way", nv)
    advance_jacobian = ca.jacobian(tree.advance(q, displacement, centred=False), displacement)
    tangent = ca.Function("tangent", [q], [ca.substitute(advance_jacobian, displacement, ca.SX.zeros(nv))])
    rows_of = _rows(touches, nv)
    tangent_rows = ca.vertsplit(rows_of(q)[1], len(names)) if names else [ca.SX(0, nv)] * 2
    is_still = [not np.any(at_random_poses(rows)) for rows in tangent_rows]
    edges = 2 if any(is_still) else edges
    first = 1 if is_still == [True, False] else 0
    space = Space(nv, lambda pose: rows_of(pose)[0], lambda pose: ca.SX(tangent(pose)), edges)

    def limit_distances(pose: ca.SX) -> ca.SX:
        low = [pose[i] - lowest for _, i, _, lowest, _ in limits]
        return ca.vertcat(*low, *(highest - pose[i] for _, i, _, _, highest in limits))

    M, forced = tree.mass(q), _smooth(tree, q, v_next, u, h, scale)
    if inertial:
        change = about_centres(tree, q, v_next) - centre_velocities(tree, q, v, h)
        inertial_impulse = h * tree.inverse_dynamics(q, v, v_next, change / h, centred=True)
    else:
        is_servo = tree.per_velocity(lambda body: None if body.servo is None else 1)
        bodies = [i for i, entry in enumerate(ca.vertsplit(is_servo)) if entry.is_zero()]
        M, inertial_impulse = M[bodies, bodies], h * tree.weight(q)
        inertial_impulse[bodies] += M @ v_next[bodies]

    def build_system(touching: ContactSpec) -> ContactSystem:
        rows = contact_rows(name, touching, q, q_next, lambda J: h * (J @ v_next), h)
        motion = inertial_impulse - h * forced - rows.push
        if coupled is not None:
            motion = coupled.constrain(motion, tree.position_of(q), v_next, h)
        return ContactSystem(
            name=name,
            x=x,
            u=u,
            x_next=x_next,
            lam=rows.lam,
            residual=ca.vertcat(q_next - tree.advance(q, h * v_next), motion),
            gap=rows.gap,
            states=(*tree.coordinates, *tree.velocities),
            inputs=tuple(_input(tree, motor) for motor in motors),
            contacts=rows.signals,
            h=h,
            parameters=parameters,
            phi=rows.phi,
            mu_per_kappa=h,
            pairs=rows.pairs,
            forces=rows.forces,
            referee_model=touching.referee_model(rows.curved, build_system),
            refinable=inertial,
            energy_balance=_book(tree, touches, first, rows, x, u, x_next, forced, h) if inertial else None,
            mass=M,
            rotating_entries=(*tree.quaternion_entries, *tree.offset_origin_entries),
        )

    ends = tuple(f"{body} {end}" for end in ("low", "high") for body, *_ in limits)

    def distance(pose: ca.SX) -> ca.SX:
        return ca.vertcat(ca.SX(0, 1), *(touch.contact.phi for touch in touches(pose)))

    def sliding(pose: ca.SX) -> ca.SX:
        return rows_of(pose)[1][len(names) * first :, :][: len(names) * min(2, edges // 2), :]

    return build_system(
        ContactSpec(
            contacts, distance, sliding, friction, cone, linearised, limit_distances if limits else None, ends, space
        )
    )


def _rows(touches: Callable[[ca.SX], list[ContactPair]], nv: int) -> Callable[[ca.SX], tuple[ca.SX, ca.SX]]:
    """Rows along normals (nc, nv), and along first and second tangents (2 nc, nv), at a pose."""

    def rows(q: ca.SX) -> tuple[ca.SX, ca.SX]:
        contact_rows = [touch.contact.jacobian_rows(touch.one, touch.other, nv) for touch in touches(q)]
        normal, *tangential = (ca.vertcat(ca.SX(0, nv), *(row[k] for row in contact_rows)) for k in range(3))
        return ca.sparsify(normal), ca.sparsify(ca.vertcat(*tangential))

    return rows


def _smooth(tree: Tree, q: ca.SX, v_next: ca.SX, u: ca.SX, h: ca.SX | float, scale: float) -> ca.SX:
    """Forces of motors, servos, springs and dampers (nv, 1), linear in v_next."""
    motor, servo = tree.per_velocity(lambda b: b.gear), tree.per_velocity(lambda b: b.servo)
    commands = ca.SX(tree.nv, 1)
    for k, name in enumerate(tree.actuated):
        commands[tree.v_of[name]] = u[k]
    position_next = tree.position_of(q) + h * v_next
    springs = tree.per_velocity(lambda b: b.spring) * (tree.per_velocity(lambda b: b.rest) - position_next)
    return (
        scale * motor * commands
        + servo * (commands - position_next)
        + springs
        - tree.per_velocity(lambda b: b.damping) * v_next
    )


def _input(tree: Tree, motor: str) -> Signal:
    body = tree.bodies[motor]
    if body.servo is None:
        return Signal(f"u_{motor}", "1", "motor")
    return Signal(f"u_{motor}", "rad" if body.joint == "hinge" else "m", "position of the servo")


def _book(
    tree: Tree,
    touches: Callable[[ca.SX], list[ContactPair]],
    first: int,
    rows: ContactRows,
    x: ca.SX,
    u: ca.SX,
    x_next: ca.SX,
    forced: ca.SX,
    h: ca.SX | float,
) -> EnergyBalance:
    q, v, v_next = x[: tree.nq], x[tree.nq :], x_next[tree.nq :]
    normal = rows.lam[: len(touches(q))] if rows.forces is None else rows.forces.normal
    tangential, n = ca.SX(0, 1) if rows.forces is None else rows.forces.tangential, normal.numel()
    external = h * tree.total_mass * tree.gravity
    for i, touch in enumerate(touches(q)):
        if touch.outside:
            external = external + normal[i] * touch.contact.normal
            tangents = touch.contact.tangents[first:]
            for k, tangent in zip(range(i, tangential.numel(), n), tangents, strict=False):
                external = external + tangential[k] * tangent
    extension = tree.per_velocity(lambda b: b.rest) - tree.position_of(q) - h * v_next
    springs = tree.per_velocity(lambda b: b.spring) * extension
    work = h * ca.dot(v_next, forced - springs)
    v_centres = about_centres(tree, q, centre_velocities(tree, q, v, h), -1)
    return EnergyBalance(tree.energy(q, v_centres), work, tree.momentum(q, v_centres), external)


def about_centres(tree: Tree, q: ca.SX, v: ca.SX, sign: int = 1) -> ca.SX:
    """v (nv, 1) with the velocity of a free body's centre of mass in place of its origin's.

    With ``sign`` -1 the other way round.
    """
    converted = ca.SX(v)
    for name, centre in tree.centres.items():
        four, spin = q[tree.q_of[name]][3:], v[tree.v_of[name]][3:]
        start = tree.v_of[name].start
        converted[start : start + 3] += sign * rotation.matrix(four) @ ca.cross(spin, centre)
    return converted


def centre_velocities(tree: Tree, q: ca.SX, v: ca.SX, h: ca.SX | float) -> ca.SX:
    """Return :func:`about_centres` of a state, whose v is that at the pose before, ``q (-) h v``.

    A step of h hands over the velocities of centres of mass exactly by that: it ends with origins'
    velocities at the pose that it set out from.
    """
    q_before = ca.SX(q)
    for name in tree.centres:
        four = slice(tree.q_of[name].start + 3, tree.q_of[name].stop)
        q_before[four] = rotation.integrate(q[four], -h * v[tree.v_of[name]][3:])
    return about_centres(tree, q_before, v)
