"""Points and bodies of a robot that tasks move, and start poses of tasks."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product

import casadi as ca
import numpy as np
from scipy.optimize import minimize

from dynamics.systems.space import WORLD, Box, Capsule, Cylinder, Hull, Plane, SpatialMachine, Sphere
from ocp.errors import InputError
from problems.robots.robot import Robot

CHANGES = {"hinge": 0.5, "slide": 0.1}
"""Largest change of each joint from home to the pose that a reach aims at [rad, m]."""
SPREAD = 0.5
"""Standard deviation of the places from which a crouch is looked for [rad, m]."""
ROOM = 0.01
"""Least distance of contacts at that pose, and of those that do not touch in a crouch [m]."""
CROUCH = 0.1
"""Share of its height by which a crouch lowers the trunk, unless another is given."""
STARTS = 4
"""Number of places from which a crouch is looked for."""
TOUCHING = 1e-6
"""Largest distance of a contact that touches [m]."""
FOOT_WEIGHT = 100.0
"""Cost of moving a foot by 1 m, as a multiple of that of turning a joint by 1 rad, when a robot crouches."""
STILL = 1e-9
"""Largest speed of a body, per unit speed of a joint, that counts as none [m/s]."""


@dataclass(frozen=True)
class BodyPlace:
    """A point fixed to a ``body``, at ``offset`` in its frame [m]."""

    body: str
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def position(self, machine: SpatialMachine, q: ca.SX) -> ca.SX:
        """Return the point's position (3, 1) in the world [m] at the pose q (nq, 1)."""
        rotation, origin = machine.tree().pose(q, self.body)
        return origin + rotation @ ca.DM(self.offset)

    def at(self, machine: SpatialMachine, pose: np.ndarray) -> np.ndarray:
        """Return the point's position (3,) in the world [m] at the pose (nq,)."""
        return np.array(ca.evalf(self.position(machine, ca.SX(pose)))).ravel()


def check_task(robot: Robot, task: str) -> None:
    """Raise :class:`~ocp.errors.InputError` that says why a task makes no sense for a robot.

    The tasks are ``stand``, ``walk`` and ``jump``, on feet, and ``reach`` and ``push``, with an end effector.
    """
    if not robot.machine.tree().actuated:
        raise InputError(f"{robot.path}: {task} needs a motor, and the robot has none")
    if task in ("stand", "walk", "jump"):
        _check_legs(robot, task)
        if task == "stand":
            crouched(robot)
    elif task == "push":
        push_direction(robot, pushed_object(robot))
    elif robot.floats:
        raise InputError(f"{robot.path}: reach is for a robot whose root is fixed, and this one's moves; try walk")
    else:
        reachable(robot)


def _check_legs(robot: Robot, task: str) -> None:
    """Raise :class:`~ocp.errors.InputError` for a robot whose root is fixed or that cannot touch the ground."""
    if not robot.floats:
        raise InputError(
            f"{robot.path}: {task} is for a robot whose root moves freely, and this one's is fixed; try reach, or free"
            " the root of a URDF with --floating or --planar"
        )
    if not robot.footholds:
        raise InputError(f"{robot.path}: {task} needs parts that may touch level ground, and the robot has none")


def end_effector(robot: Robot) -> BodyPlace:
    """Return the end of the longest chain of motors: the middle of the last body's farthest part.

    Among chains with equally many motors the longest, then the first is chosen. If the last body has no parts, the
    result is its centre of mass.
    """
    machine = robot.machine
    tree = machine.tree()
    chains = {name: _ancestors(machine, name) for name in tree.bodies if name not in robot.objects}
    motors = {name: sum(link in tree.actuated for link in chain) for name, chain in chains.items()}
    longest = max(motors.values())
    # The body farthest from the root: parts may be fixed to bodies without motors behind the last motor.
    last = max((name for name, count in motors.items() if count == longest), key=lambda name: len(chains[name]))
    points = [point for part in machine.parts if part.body == last for point in _middles(part.shape)]
    end_point = max(points, key=lambda point: math.hypot(*point), default=tree.bodies[last].com)
    return BodyPlace(last, tuple(float(ca.evalf(ca.SX(x))) for x in end_point))  # pyright: ignore[reportArgumentType]


def pushed_object(robot: Robot) -> str:
    """Return the first body without a motor that the robot's own bodies may touch.

    Raises :class:`~ocp.errors.InputError` if there is no such body.
    """
    pairs = robot.machine.contacts_with_bodies(ca.SX(robot.home)).values()
    for _, *owners in pairs:
        passive = [body for body in owners if body in robot.objects]
        if len(passive) == 1 and WORLD not in owners:
            return passive[0]
    raise InputError(
        f"{robot.path}: push needs an object, a body that no motor moves and that the robot may touch; add one to the"
        " file, with geoms that collide"
    )


def push_direction(robot: Robot, pushed: str) -> np.ndarray:
    """Return the horizontal unit vector (3,) from the robot's base to an object, in directions in which it moves."""
    machine, home = robot.machine, ca.SX(robot.home)
    base = BodyPlace(_ancestors(machine, end_effector(robot).body)[-1])
    moves = ca.horzcat(*(translation for _, _, translation, _ in machine.tree().joint_axes(home, pushed)))
    is_free = np.abs(np.array(ca.evalf(moves))).max(axis=1) > STILL
    offset = BodyPlace(pushed).at(machine, robot.home) - base.at(machine, robot.home)
    offset = np.where(is_free * [True, True, False], offset, 0.0)
    length = float(np.linalg.norm(offset))
    if length == 0:
        raise InputError(f"{robot.path}: push needs an object that slides along x or y, and {pushed} does not")
    return offset / length


def reachable(robot: Robot) -> np.ndarray:
    """Return a position (3,) [m] of the end effector at a contact-free pose in which all its joints have moved.

    Joints move by :data:`CHANGES`, up to their limits, in the directions that move the end effector farthest.
    """
    machine, tip = robot.machine, end_effector(robot)
    start, best = tip.at(machine, robot.home), None
    touching = machine.contacts_with_bodies(ca.SX(robot.home)).values()
    passive = {*robot.objects, WORLD}
    moving = [i for i, (_, *owners) in enumerate(touching) if not passive.issuperset(owners)]
    joints = [name for name in _ancestors(machine, tip.body) if machine.tree().bodies[name].joint in CHANGES]
    for signs in product((1.0, -1.0), repeat=min(4, len(joints))):
        turns = {
            name: sign * CHANGES[machine.tree().bodies[name].joint]
            for name, sign in zip(joints, np.resize(signs, len(joints)), strict=True)
        }
        pose = np.array(ca.evalf(robot.with_joints_moved(robot.home, turns))).ravel()
        if np.min(np.array(robot.distances(pose)).ravel()[moving], initial=np.inf) < ROOM:
            continue
        tip_position = tip.at(machine, pose)
        if best is None or np.linalg.norm(tip_position - start) > np.linalg.norm(best - start):
            best = tip_position
    if best is None:
        raise InputError(
            f"{robot.path}: reach found no free place for {tip.body}; give the file a keyframe home away from contacts"
        )
    if np.linalg.norm(best - start) < ROOM:
        raise InputError(f"{robot.path}: reach needs joints that move the end of {tip.body}, and the robot has none")
    return best


def crouched(robot: Robot, share: float = CROUCH) -> np.ndarray:
    """Return a pose (nq,) with the trunk upright and lowered by ``share`` of its height, and the same ground contacts.

    The pose minimises the distance to :meth:`~problems.robots.Robot.standing` in joint angles and positions of the
    feet. Raises :class:`~ocp.errors.InputError` if the robot has no such pose.
    """
    stands, machine = robot.standing(), robot.machine
    q = ca.SX.sym("q", len(stands))
    joints = [i for i in range(len(stands)) if i not in robot.root_entries]
    low = robot.raised(stands, -share * trunk_height(robot))
    pose = ca.SX(low)
    pose[joints] = q[joints]
    names = list(robot.friction)
    distances, contacts = robot.distances(stands).full().ravel(), machine.contacts(pose)
    standing_contacts, phi = machine.contacts(ca.SX(stands)), robot.distances(pose)
    cost, equal, free = ca.sumsqr(pose - low), ca.SX(0, 1), ca.SX(0, 1)
    for i, name in enumerate(names):
        if i in robot.footholds and distances[i] < TOUCHING:
            equal = ca.vertcat(equal, phi[i])
            cost += FOOT_WEIGHT * ca.sumsqr(contacts[name].point - standing_contacts[name].point)
        else:
            free = ca.vertcat(free, phi[i] - min(distances[i], ROOM))
    ties = machine.coupled_joints()
    if ties is not None:
        equal = ca.vertcat(equal, pose - ties.close(machine.tree(), pose))
    joint_angles = None
    if joints:
        joint_angles = _nearest(q[joints], (cost, equal, free), stands[joints], _limits(robot, joints))
    if joint_angles is None:
        raise InputError(
            f"{robot.path}: the robot cannot lower its trunk by {100 * share:.3g} % and keep it upright; give the file"
            " a keyframe home in which legs can bend"
        )
    crouch = np.array(ca.evalf(low)).ravel()
    crouch[joints] = joint_angles
    return crouch


def trunk_height(robot: Robot) -> float:
    """Return the height [m] of the root's last body in the standing pose."""
    return float(BodyPlace(robot.root_bodies[-1]).at(robot.machine, robot.standing())[2])


def _nearest(z: ca.SX, terms: tuple[ca.SX, ca.SX, ca.SX], start: np.ndarray, limits: np.ndarray) -> np.ndarray | None:
    """Return z (n,) that minimises ``cost`` subject to ``equal = 0`` and ``free >= 0``, or None if no solve succeeds.

    ``terms`` are (cost, equal, free) and ``limits`` (n, 2) the bounds on z. The result is the best of several solves
    from seeded random points around ``start``: if a leg is straight, the height has no first-order change at ``start``.
    """
    cost, equal, free = (ca.Function("term", [z], [term, ca.jacobian(term, z)]) for term in terms)

    def row(function: ca.Function, kind: str) -> dict[str, object]:
        values, slopes = (lambda x: function(x)[0].full().ravel()), (lambda x: function(x)[1].full())
        return {"fun": values, "jac": slopes, "type": kind}

    rows = [row(function, kind) for function, kind in ((equal, "eq"), (free, "ineq")) if function.numel_out(0)]
    rng, minima = np.random.default_rng(0), []
    for _ in range(STARTS):
        minimum = minimize(
            lambda x: float(cost(x)[0]),
            np.clip(start + rng.normal(scale=SPREAD, size=len(start)), *limits.T),
            jac=lambda x: cost(x)[1].full().ravel(),
            bounds=limits,
            constraints=rows,
            method="SLSQP",
            options={"maxiter": 300},
        )
        if minimum.success:
            minima.append(minimum)
    return min(minima, key=lambda minimum: minimum.fun).x if minima else None


def _limits(robot: Robot, entries: list[int]) -> np.ndarray:
    """Return lower and upper limits (n, 2) of entries of q."""
    limits = {entry: (float(low), float(high)) for _, entry, _, low, high in robot.machine.tree().limits}
    return np.array([limits.get(entry, (-math.inf, math.inf)) for entry in entries]).reshape(-1, 2)


def _ancestors(machine: SpatialMachine, body: str) -> list[str]:
    """Return the bodies from ``body`` to its root."""
    chain = list[str]()
    while body != WORLD and body is not None:
        chain.append(body)
        body = machine.tree().bodies[body].parent  # pyright: ignore[reportAssignmentType]
    return chain


def _middles(shape: Sphere | Capsule | Cylinder | Box | Hull | Plane) -> list[tuple]:
    """Return points in the middle of a shape: its centre, or the ends of its axis."""
    if isinstance(shape, Capsule | Cylinder):
        return [shape.start, shape.end]
    if isinstance(shape, Sphere | Box):
        return [shape.centre]
    return [tuple(sum(xs) / len(xs) for xs in zip(*shape.points, strict=True))] if isinstance(shape, Hull) else []
