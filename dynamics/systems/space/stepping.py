"""The step of a machine in space: time stepping on the tangent space of its positions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np

from dynamics.systems.checks import positive
from dynamics.systems.contact_rows import FORMS, Cone, ContactRows, Space, Touching, contact_rows
from dynamics.systems.pairs import EnergyBook
from dynamics.systems.parameters import ParameterTable, Signal
from dynamics.systems.space import rotation
from dynamics.systems.space.contact import Motions, SpatialContact, at_random_poses
from dynamics.systems.space.coupling import CoupledJoints
from dynamics.systems.space.tree import Tree
from dynamics.systems.system import ContactSystem

_EDGES = (4, 8)


@dataclass(frozen=True, eq=False)
class Touch:
    """A contact at a pose: its name, what moves A and B, and whether B is the world."""

    name: str
    contact: SpatialContact
    one: Motions
    other: Motions
    outside: bool


def spatial_step(
    name: str,
    tree: Tree,
    touches: Callable[[ca.SX], list[Touch]],
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
    positive(f"system {name!r}: h", h)
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
    contacts = tuple(Signal(one, "N s", "normal impulse") for one in names)
    limits = tree.limits
    way = ca.SX.sym("way", nv)
    stretched = ca.jacobian(tree.advance(q, way, centred=False), way)
    tangent = ca.Function("tangent", [q], [ca.substitute(stretched, way, ca.SX.zeros(nv))])
    rows_of = _rows(touches, nv)
    along = ca.vertsplit(rows_of(q)[1], len(names)) if names else [ca.SX(0, nv)] * 2
    still = [not np.any(at_random_poses(rows)) for rows in along]
    edges = 2 if any(still) else edges
    first = 1 if still == [True, False] else 0
    space = Space(nv, lambda at: rows_of(at)[0], lambda at: ca.SX(tangent(at)), edges)

    def left(at: ca.SX) -> ca.SX:
        low = [at[i] - lowest for _, i, _, lowest, _ in limits]
        return ca.vertcat(*low, *(highest - at[i] for _, i, _, _, highest in limits))

    M, forced = tree.mass(q), _smooth(tree, q, v_next, u, h, scale)
    if inertial:
        change = about_centres(tree, q, v_next) - centre_velocities(tree, q, v, h)
        moved = h * tree.inverse_dynamics(q, v, v_next, change / h, centred=True)
    else:
        driven = tree.each(lambda body: None if body.servo is None else 1)
        bodies = [i for i, entry in enumerate(ca.vertsplit(driven)) if entry.is_zero()]
        M, moved = M[bodies, bodies], h * tree.weight(q)
        moved[bodies] += M @ v_next[bodies]

    def built(touching: Touching) -> ContactSystem:
        rows = contact_rows(name, touching, q, q_next, lambda J: h * (J @ v_next), h)
        motion = moved - h * forced - rows.push
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
            sharp=touching.sharp(rows.curved, built),
            refinable=inertial,
            book=_book(tree, touches, first, rows, x, u, x_next, forced, h) if inertial else None,
            mass=M,
            turning=(*tree.turning, *tree.swinging),
        )

    ends = tuple(f"{body} {end}" for end in ("low", "high") for body, *_ in limits)

    def distance(at: ca.SX) -> ca.SX:
        return ca.vertcat(ca.SX(0, 1), *(touch.contact.phi for touch in touches(at)))

    def sliding(at: ca.SX) -> ca.SX:
        return rows_of(at)[1][len(names) * first :, :][: len(names) * min(2, edges // 2), :]

    return built(
        Touching(contacts, distance, sliding, friction, cone, linearised, left if limits else None, ends, space)
    )


def _rows(touches: Callable[[ca.SX], list[Touch]], nv: int) -> Callable[[ca.SX], tuple[ca.SX, ca.SX]]:
    """Rows along normals (nc, nv), and along first and second tangents (2 nc, nv), at a pose."""

    def rows(q: ca.SX) -> tuple[ca.SX, ca.SX]:
        found = [touch.contact.rows(touch.one, touch.other, nv) for touch in touches(q)]
        normal, *along = (ca.vertcat(ca.SX(0, nv), *(row[k] for row in found)) for k in range(3))
        return ca.sparsify(normal), ca.sparsify(ca.vertcat(*along))

    return rows


def _smooth(tree: Tree, q: ca.SX, v_next: ca.SX, u: ca.SX, h: ca.SX | float, scale: float) -> ca.SX:
    """Forces of motors, servos, springs and dampers (nv, 1), linear in v_next."""
    motor, servo = tree.each(lambda b: b.gear), tree.each(lambda b: b.servo)
    asked = ca.SX(tree.nv, 1)
    for k, name in enumerate(tree.actuated):
        asked[tree.v_of[name]] = u[k]
    stands = tree.position_of(q) + h * v_next
    springs = tree.each(lambda b: b.spring) * (tree.each(lambda b: b.rest) - stands)
    return scale * motor * asked + servo * (asked - stands) + springs - tree.each(lambda b: b.damping) * v_next


def _input(tree: Tree, motor: str) -> Signal:
    body = tree.bodies[motor]
    if body.servo is None:
        return Signal(f"u_{motor}", "1", "motor")
    return Signal(f"u_{motor}", "rad" if body.joint == "hinge" else "m", "position of the servo")


def _book(
    tree: Tree,
    touches: Callable[[ca.SX], list[Touch]],
    first: int,
    rows: ContactRows,
    x: ca.SX,
    u: ca.SX,
    x_next: ca.SX,
    forced: ca.SX,
    h: ca.SX | float,
) -> EnergyBook:
    q, v, v_next = x[: tree.nq], x[tree.nq :], x_next[tree.nq :]
    normal = rows.lam[: len(touches(q))] if rows.forces is None else rows.forces.normal
    along, n = ca.SX(0, 1) if rows.forces is None else rows.forces.tangential, normal.numel()
    external = h * tree.total_mass * tree.gravity
    for i, touch in enumerate(touches(q)):
        if touch.outside:
            external = external + normal[i] * touch.contact.normal
            tangents = touch.contact.tangents[first:]
            for k, tangent in zip(range(i, along.numel(), n), tangents, strict=False):
                external = external + along[k] * tangent
    springs = tree.each(lambda b: b.spring) * (tree.each(lambda b: b.rest) - tree.position_of(q) - h * v_next)
    work = h * ca.dot(v_next, forced - springs)
    here = about_centres(tree, q, centre_velocities(tree, q, v, h), -1)
    return EnergyBook(tree.energy(q, here), work, tree.momentum(q, here), external)


def about_centres(tree: Tree, q: ca.SX, v: ca.SX, sign: int = 1) -> ca.SX:
    """v (nv, 1) with the velocity of a free body's centre of mass in place of its origin's.

    With ``sign`` -1 the other way round.
    """
    found = ca.SX(v)
    for name, centre in tree.centres.items():
        four, spin = q[tree.q_of[name]][3:], v[tree.v_of[name]][3:]
        start = tree.v_of[name].start
        found[start : start + 3] += sign * rotation.matrix(four) @ ca.cross(spin, centre)
    return found


def centre_velocities(tree: Tree, q: ca.SX, v: ca.SX, h: ca.SX | float) -> ca.SX:
    """Return :func:`about_centres` of a state, whose v is that at the pose before, ``q (-) h v``.

    A step of h hands over the velocities of centres of mass exactly by that: it ends with origins'
    velocities at the pose that it set out from.
    """
    before = ca.SX(q)
    for name in tree.centres:
        four = slice(tree.q_of[name].start + 3, tree.q_of[name].stop)
        before[four] = rotation.turned(q[four], -h * v[tree.v_of[name]][3:])
    return about_centres(tree, before, v)
