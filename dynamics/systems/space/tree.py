"""Equations of motion of trees of bodies in space, by recursion in the axes of each body."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property

import casadi as ca

from dynamics.systems.memoise import OncePerPose
from dynamics.systems.parameters import Signal
from dynamics.systems.planar.links import root_first
from dynamics.systems.space import rotation
from dynamics.systems.space.body import POSITIONS, VELOCITIES, Body, Number, Vector
from dynamics.systems.space.joints import JointFrame, joint_frame


class Tree:
    """Equations of motion of trees of rigid bodies in space.

    ``M(q) dv/dt + C(q, v) v + g(q) = B u + springs + dampers + contact forces``. M comes from the
    composite-rigid-body algorithm, the rest from Newton-Euler recursions in the axes of each body (Featherstone,
    Rigid Body Dynamics Algorithms, 2008, ch. 5-6). q and v are in the order of the given bodies. As in MuJoCo, a free
    joint has its position in the world and its quaternion, the velocity of its origin in the world's axes and its
    angular velocity in the body's axes.

    All methods take and return SX expressions; quaternions in q must be of unit length. Raises ``ValueError`` if the
    bodies do not form a tree.
    """

    def __init__(self, bodies: Sequence[Body], gravity: Vector = (0.0, 0.0, -9.81)) -> None:
        self.gravity = ca.SX(ca.vertcat(*gravity))
        self._ordered = root_first(bodies)
        self.bodies = {body.name: body for body in bodies}
        self.q_of: dict[str, slice] = {}
        self.v_of: dict[str, slice] = {}
        nq = nv = 0
        for body in bodies:
            self.q_of[body.name] = slice(nq, nq := nq + POSITIONS[body.joint])
            self.v_of[body.name] = slice(nv, nv := nv + VELOCITIES[body.joint])
        self.nq, self.nv = nq, nv
        self._joints = OncePerPose(self._joint_frames)
        self._poses = OncePerPose(self._body_poses)

    @property
    def coordinates(self) -> tuple[Signal, ...]:
        """Names and units of q."""
        return tuple(signal for body in self.bodies.values() for signal in body.positions)

    @property
    def velocities(self) -> tuple[Signal, ...]:
        """Names and units of v."""
        return tuple(signal for body in self.bodies.values() for signal in body.velocities)

    @property
    def actuated(self) -> tuple[str, ...]:
        """Names of the bodies whose joints have a motor or a servo, in the order of inputs."""
        named_bodies = self.bodies.items()
        return tuple(n for n, body in named_bodies if body.gear is not None or body.servo is not None)

    @property
    def limits(self) -> list[tuple[str, int, int, Number, Number]]:
        """Limits as (body, index into q, index into v, lowest, highest)."""
        return [
            (name, self.q_of[name].start, self.v_of[name].start, *body.limits)
            for name, body in self.bodies.items()
            if body.limits is not None
        ]

    @cached_property
    def quaternion_entries(self) -> list[int]:
        """Indices into q of all quaternions."""
        quaternion_entries = {"free": slice(3, 7), "ball": slice(0, 4)}
        return [
            i
            for name, body in self.bodies.items()
            if body.joint in quaternion_entries
            for i in range(self.nq)[self.q_of[name]][quaternion_entries[body.joint]]
        ]

    @cached_property
    def centres(self) -> dict[str, ca.SX]:
        """Mapping from names of free bodies whose centre of mass is not the origin to this centre (3, 1) [m]."""
        centres = {
            name: ca.sparsify(ca.SX(ca.vertcat(*body.com)))
            for name, body in self.bodies.items()
            if body.joint == "free"
        }
        return {name: centre for name, centre in centres.items() if centre.nnz()}

    @cached_property
    def offset_origin_entries(self) -> list[int]:
        """Indices into q of the origins of free bodies whose centre of mass is not the origin."""
        return [self.q_of[name].start + k for name in self.centres for k in range(3)]

    @cached_property
    def total_mass(self) -> ca.SX:
        """Mass of all bodies [kg]."""
        return sum((ca.SX(body.mass) for body in self._ordered), ca.SX(0))

    def per_velocity(self, value: Callable[[Body], Number | None]) -> ca.SX:
        """Return, for each velocity, the ``value`` of the body of its joint (nv, 1), zero if the value is None."""
        values = (value(body) for body in self.bodies.values() for _ in range(VELOCITIES[body.joint]))
        return ca.sparsify(ca.vertcat(ca.SX(0, 1), *(ca.SX(0 if entry is None else entry) for entry in values)))

    def position_of(self, q: ca.SX) -> ca.SX:
        """Positions of hinges and slides in the order of v (nv, 1), zero for other joints."""
        positions = ca.SX(self.nv, 1)
        for name, body in self.bodies.items():
            if body.joint in ("hinge", "slide"):
                positions[self.v_of[name]] = q[self.q_of[name]]
        return positions

    def advance(self, q: ca.SX, displacements: ca.SX, *, centred: bool = True) -> ca.SX:
        """Return ``q (+) displacements`` (nq, 1), with displacements (nv, 1) along v; quaternions rotate exactly.

        The centre of mass of a free body moves in a straight line and its origin rotates about it; if not
        ``centred``, the origin moves in a straight line, which is the same to first order.
        """
        q_parts = []
        for name, body in self.bodies.items():
            joint_q, displacement = q[self.q_of[name]], displacements[self.v_of[name]]
            if body.joint in ("free", "ball"):
                n = joint_q.numel() - 4
                origin = joint_q[:n] + displacement[:n]
                new_quaternion = rotation.integrate(joint_q[n:], displacement[n:])
                if centred and name in self.centres:
                    R, R_new = rotation.matrix(joint_q[n:]), rotation.matrix(new_quaternion)
                    centre = self.centres[name]
                    origin += R @ (ca.cross(displacement[n:], centre) + centre) - R_new @ centre
                q_parts += [origin, new_quaternion]
            else:
                q_parts.append(joint_q + displacement)
        return ca.vertcat(*q_parts)

    def pose(self, q: ca.SX, body: str) -> tuple[ca.SX, ca.SX]:
        """Rotation (3, 3) of a body's axes into the world's axes, and the body's origin in the world (3, 1) [m]."""
        return self._poses(q)[body]

    def joint_axes(self, q: ca.SX, body: str) -> list[tuple[int, ca.SX, ca.SX, ca.SX]]:
        """Return the axes that move a body: (index into v, rotation axis, direction of motion, a point of the axis).

        The vectors are in the world's axes; the list covers the joints of the body and of its ancestors.
        """
        axes, joints, ancestor = [], self._joints(q), body
        while ancestor is not None:
            (R, p), joint, start = self.pose(q, ancestor), joints[ancestor], self.v_of[ancestor].start
            free = 3 if self.bodies[ancestor].joint == "free" else 0
            axes += [(start + k, ca.SX(3, 1), ca.SX.eye(3)[:, k], p) for k in range(free)]
            for k in range(joint.turns.size2()):
                rotation_axis, translation_axis = R @ joint.turns[:, k], R @ joint.moves[:, k]
                axes.append((start + free + k, rotation_axis, translation_axis, p))
            ancestor = self.bodies[ancestor].parent
        return axes

    def mass(self, q: ca.SX) -> ca.SX:
        """Mass matrix M(q) (nv, nv), symmetric positive definite [kg, kg m, kg m²]."""
        joints, M = self._joints(q), ca.SX(self.nv, self.nv)
        for name, (mass, first, second) in self._composites(joints).items():
            joint, free = joints[name], self.bodies[name].joint == "free"
            for k in range(joint.turns.size2()):
                rotation_axis, translation_axis = joint.turns[:, k], joint.moves[:, k]
                momentum = mass * translation_axis + ca.cross(rotation_axis, first)
                spin = second @ rotation_axis + ca.cross(first, translation_axis)
                column = self.v_of[name].start + k + 3 * free
                ancestor: str | None = name
                while ancestor is not None:
                    above = joints[ancestor]
                    rows = above.turns.T @ spin + above.moves.T @ momentum
                    outer = above.R @ momentum
                    if self.bodies[ancestor].joint == "free":
                        rows = ca.vertcat(outer, rows)
                    start = self.v_of[ancestor].start
                    for row in range(rows.numel()):
                        M[start + row, column] = M[column, start + row] = rows[row]
                    spin = above.R @ spin + ca.cross(above.r, outer)
                    momentum, ancestor = outer, self.bodies[ancestor].parent
            if free:
                linear_rows = range(self.nv)[self.v_of[name]][:3]
                M[linear_rows, linear_rows] = mass * ca.SX.eye(3)
        return M + ca.diag(self.per_velocity(lambda body: body.armature))

    def bias(self, q: ca.SX, v: ca.SX) -> ca.SX:
        """Coriolis, centrifugal and gravity forces (nv, 1) [N m, N]."""
        return self.inverse_dynamics(q, v, v, ca.SX(self.nv, 1))

    def weight(self, q: ca.SX) -> ca.SX:
        """Forces that hold the tree against gravity (nv, 1) [N m, N]."""
        zero = ca.SX(self.nv, 1)
        return self.inverse_dynamics(q, zero, zero, zero)

    def inverse_dynamics(
        self,
        q: ca.SX,
        v: ca.SX,
        w: ca.SX,
        a: ca.SX,
        *,
        centred: bool = False,
    ) -> ca.SX:
        """Force ``M(q) a + C(q, v) w + g(q)`` (nv, 1) without forming M [N m, N].

        ``C(q, v) w`` is linear in v and in w, with ``dM/dt = C + C'`` along v, so that
        ``w' (dM/dt - 2 C) w = 0`` for every w, and velocity forces can be implicit in w. Niemeyer and Slotine, doi
        10.1177/027836499101000201; Echeandia and Wensing, doi 10.1115/1.4051169.

        If ``centred``, a contains the accelerations of free bodies' centres of mass, the rate of change of
        :func:`~dynamics.systems.space.stepping.about_centres`, in place of the accelerations of their origins.
        """
        joints = self._joints(q)
        states = self._accelerations(joints, v, w, a, -self.gravity, self.centres if centred else {})
        force = {body.name: ca.SX(3, 1) for body in self._ordered}
        moment = dict(force)
        result = ca.SX(self.nv, 1)
        for body in reversed(self._ordered):
            name, joint = body.name, joints[body.name]
            omega, omega_w, alpha, acceleration = states[name]
            com, inertia = ca.SX(ca.vertcat(*body.com)), body.inertia_matrix
            body_force = ca.SX(body.mass) * (
                acceleration + ca.cross(alpha, com) + ca.cross(omega_w, ca.cross(omega, com))
            )
            spin = inertia @ (alpha - ca.cross(omega, omega_w)) + ca.cross(omega_w, inertia @ omega)
            force[name] += body_force
            moment[name] += spin + ca.cross(com, body_force)
            parent_force = joint.R @ force[name]
            result[self.v_of[name]] = ca.vertcat(
                parent_force if body.joint == "free" else ca.SX(0, 1),
                joint.turns.T @ moment[name] + joint.moves.T @ force[name],
            )
            if body.parent is not None:
                force[body.parent] += parent_force
                moment[body.parent] += joint.R @ moment[name] + ca.cross(joint.r, parent_force)
        return result + self.per_velocity(lambda body: body.armature) * a

    def potential(self, q: ca.SX) -> ca.SX:
        """Energy of gravity (zero at the origin) and of the springs [J]."""
        moment = ca.SX(3, 1)
        for body in self._ordered:
            R, p = self.pose(q, body.name)
            moment += ca.SX(body.mass) * (p + R @ ca.SX(ca.vertcat(*body.com)))
        extension = self.position_of(q) - self.per_velocity(lambda body: body.rest)
        return ca.dot(self.per_velocity(lambda b: b.spring), extension**2) / 2 - ca.dot(self.gravity, moment)

    def energy(self, q: ca.SX, v: ca.SX) -> ca.SX:
        """Kinetic and potential energy [J]."""
        return ca.dot(v, self.mass(q) @ v) / 2 + self.potential(q)

    def momentum(self, q: ca.SX, v: ca.SX) -> ca.SX:
        """Linear momentum (3, 1) [N s]."""
        total = ca.SX(3, 1)
        for body in self._ordered:
            R, p = self.pose(q, body.name)
            centre = p + R @ ca.SX(ca.vertcat(*body.com))
            for index, rotation_axis, translation_axis, pivot in self.joint_axes(q, body.name):
                total += ca.SX(body.mass) * v[index] * (translation_axis + ca.cross(rotation_axis, centre - pivot))
        return total

    def _joint_frames(self, q: ca.SX) -> dict[str, JointFrame]:
        return {body.name: joint_frame(body, q[self.q_of[body.name]]) for body in self._ordered}

    def _body_poses(self, q: ca.SX) -> dict[str, tuple[ca.SX, ca.SX]]:
        poses: dict[str, tuple[ca.SX, ca.SX]] = {}
        for body in self._ordered:
            joint = self._joints(q)[body.name]
            if body.parent is None:
                poses[body.name] = joint.R, joint.r
            else:
                R, p = poses[body.parent]
                poses[body.name] = R @ joint.R, p + R @ joint.r
        return poses

    def _composites(self, joints: dict[str, JointFrame]) -> dict[str, tuple[ca.SX, ca.SX, ca.SX]]:
        """Return mass, first and second moment about its origin for each body together with its descendants."""
        composites = {}
        for body in self._ordered:
            com, mass = ca.sparsify(ca.SX(ca.vertcat(*body.com))), ca.SX(body.mass)
            composites[body.name] = mass, mass * com, body.inertia_matrix + mass * _second_moment(com, com)
        for body in reversed(self._ordered):
            if body.parent is None:
                continue
            joint, (mass, first, second) = joints[body.name], composites[body.name]
            above, first = composites[body.parent], joint.R @ first
            moved_second = _symmetric(joint.R @ second @ joint.R.T) + mass * _second_moment(joint.r, joint.r)
            cross = _second_moment(first, joint.r) + _second_moment(joint.r, first)
            composites[body.parent] = (
                above[0] + mass,
                above[1] + first + mass * joint.r,
                above[2] + moved_second + _symmetric(cross),
            )
        return composites

    def _accelerations(
        self,
        joints: dict[str, JointFrame],
        v: ca.SX,
        w: ca.SX,
        a: ca.SX,
        world_acceleration: ca.SX,
        centres: dict[str, ca.SX],
    ) -> dict[str, tuple[ca.SX, ca.SX, ca.SX, ca.SX]]:
        """Return, for each body, angular velocities of v and of w, and angular and linear acceleration of its origin.

        All are in the body's axes; ``world_acceleration`` is the acceleration of the world. For bodies in
        ``centres``, a contains the acceleration of this point, not of the origin.
        """
        zero = ca.SX(3, 1)
        states: dict[str, tuple[ca.SX, ca.SX, ca.SX, ca.SX]] = {}
        for body in self._ordered:
            joint, rows = joints[body.name], self.v_of[body.name]
            omega, omega_w, alpha, acceleration = states.get(body.parent or "", (zero, zero, zero, world_acceleration))
            joint_v, joint_w, joint_a = v[rows], w[rows], a[rows]
            if body.joint == "free":
                acceleration = acceleration + joint_a[:3]
                joint_v, joint_w, joint_a = joint_v[3:], joint_w[3:], joint_a[3:]
            else:
                acceleration = acceleration + ca.cross(alpha, joint.r) + ca.cross(omega_w, ca.cross(omega, joint.r))
            inward = joint.R.T
            omega, omega_w, alpha, acceleration = (inward @ vector for vector in (omega, omega_w, alpha, acceleration))
            slide_v, slide_w = joint.moves @ joint_v, joint.moves @ joint_w
            acceleration = acceleration + joint.moves @ joint_a
            acceleration = acceleration + ca.cross(omega_w, slide_v) + ca.cross(omega, slide_w)
            turn_w = joint.turns @ joint_w
            frame_omega = omega if body.joint == "hinge" else omega + joint.turns @ joint_v
            alpha = alpha + joint.turns @ joint_a + ca.cross(frame_omega, turn_w)
            omega, omega_w = omega + joint.turns @ joint_v, omega_w + turn_w
            if (centre := centres.get(body.name)) is not None:
                acceleration -= ca.cross(alpha, centre) + ca.cross(omega_w, ca.cross(omega, centre))
            states[body.name] = omega, omega_w, alpha, acceleration
        return states


def _second_moment(a: ca.SX, b: ca.SX) -> ca.SX:
    """Return ``a'b 1 - a b'``; for a = b this is the second moment of a point mass of 1 kg at a."""
    return ca.dot(a, b) * ca.SX.eye(3) - a @ b.T


def _symmetric(A: ca.SX) -> ca.SX:
    """Return the symmetric matrix with the upper triangle of A, so that the lower triangle is not computed."""
    return ca.triu2symm(ca.triu(A))
