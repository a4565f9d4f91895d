"""Equations of motion of open planar chains, by recursion over their tree of links."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca

from dynamics.systems.memoise import OncePerPose
from dynamics.systems.parameters import Signal
from dynamics.systems.planar.links import Link, Number, Vector, root_first
from dynamics.systems.shapes.planar import Pose


@dataclass(frozen=True, eq=False)
class _Frame(Pose):
    """Pose of a link, and the vector ``step`` (2, 1) [m] from its parent's origin to the link's origin."""

    step: ca.SX


@dataclass(frozen=True, eq=False)
class _Motion:
    """Motion of a link per unit of one coordinate: rotation about the joint, or translation along ``direction``."""

    rotation: float
    direction: ca.SX


# Frame of the world.
_WORLD = _Frame(ca.SX.zeros(2), ca.SX(0), ca.SX.zeros(2))


def _swing(r: ca.SX) -> ca.SX:
    """Return the velocity (2, 1) of a point at ``r`` from a centre that rotates at 1 rad/s about +y."""
    return ca.vertcat(r[1], -r[0])


def _moment(r: ca.SX, force: ca.SX) -> ca.SX:
    return r[1] * force[0] - r[0] * force[1]


class Chain:
    """Equations of motion of trees of rigid links in the vertical plane.

    ``M(q) dv/dt + bias(q, v) = B u + spring(q) + damping(v) + contact forces``, the Euler-Lagrange equations of
    ``L = kinetic - potential`` without other forces. M comes from the composite-rigid-body algorithm, the rest
    from Newton-Euler recursions (Featherstone, Rigid Body Dynamics Algorithms, 2008, ch. 5-6), whose graphs are
    several times smaller than graphs of derivatives of L. Coordinates ``q`` (nq, 1) are in the order of the given
    links. All methods take and return SX expressions; q and v may be any expressions.

    Raises ``ValueError`` if the links do not form a tree.
    """

    def __init__(self, links: Sequence[Link], gravity: Number | Vector = 9.81) -> None:
        # Acceleration of gravity (x, z) [m/s²]; a number points down.
        self.gravity = gravity if isinstance(gravity, tuple) else (0.0, -gravity)
        self._ordered = root_first(links)
        self._links = {link.name: link for link in links}
        self._first: dict[str, int] = {}
        coordinates: list[Signal] = []
        for link in links:
            self._first[link.name] = len(coordinates)
            coordinates += _coordinates(link)
        self.coordinates: tuple[Signal, ...] = tuple(coordinates)
        """Names and units of q."""
        self._frames = OncePerPose(self._link_frames)

    @property
    def nq(self) -> int:
        """Number of coordinates."""
        return len(self.coordinates)

    @property
    def velocities(self) -> tuple[Signal, ...]:
        """Names and units of v = dq/dt."""
        return tuple(Signal(f"v_{c.name}", f"{c.unit}/s", f"velocity of {c.name}") for c in self.coordinates)

    @property
    def actuated(self) -> tuple[str, ...]:
        """Names of the links whose joints have a motor, in the order of the columns of B."""
        return tuple(name for name, link in self._links.items() if link.gear is not None)

    @property
    def limits(self) -> list[tuple[int, Number, Number]]:
        """Limits of the joints as (index into q, lowest, highest)."""
        return [(self._first[name], *link.limits) for name, link in self._links.items() if link.limits is not None]

    @cached_property
    def total_mass(self) -> ca.SX:
        """Mass of all links [kg]."""
        return sum((ca.SX(link.mass) for link in self._ordered), ca.SX(0))

    @cached_property
    def B(self) -> ca.SX:
        """Actuation matrix (nq, nu): gears [N m or N per unit of input]."""
        B = ca.SX(self.nq, len(self.actuated))
        for column, name in enumerate(self.actuated):
            gear = self._links[name].gear
            assert gear is not None
            B[self._first[name], column] = gear
        return B

    def spring(self, q: ca.SX) -> ca.SX:
        """Force of the springs (nq, 1), ``-k q`` [N m, N]."""
        return -self._per_coordinate(lambda link: link.spring) * q

    def damping(self, v: ca.SX) -> ca.SX:
        """Force of the dampers (nq, 1), ``-d v`` [N m, N]."""
        return -self._per_coordinate(lambda link: link.damping) * v

    def pose(self, q: ca.SX, link: str) -> Pose:
        """Origin (2, 1) [m] and angle [rad] of a link's frame in the world."""
        return self._frames(q)[link]

    def position(self, q: ca.SX, link: str, point: Vector = (0.0, 0.0)) -> ca.SX:
        """World position (2, 1) [m] of a point given in a link's frame."""
        return self._frames(q)[link].to_world(point)

    def mass(self, q: ca.SX) -> ca.SX:
        """Mass matrix M(q) (nq, nq), symmetric positive definite [kg, kg m, kg m²]."""
        frames = self._frames(q)
        M = ca.SX(self.nq, self.nq)
        for name, (mass, first, second) in self._composites(frames).items():
            for column, motion in self._motions(name, frames):
                # Momentum of everything that this coordinate moves, about the joint; moved
                # towards the root, it gives the entry of each ancestor's coordinate.
                momentum = mass * motion.direction + motion.rotation * _swing(first)
                spin = motion.rotation * second + _moment(first, motion.direction)
                ancestor: str | None = name
                while ancestor is not None:
                    for row, other in self._motions(ancestor, frames):
                        M[row, column] = M[column, row] = other.rotation * spin + other.direction.T @ momentum
                    spin = spin + _moment(frames[ancestor].step, momentum)
                    ancestor = self._links[ancestor].parent
        return M + ca.diag(self.armature)

    def bias(self, q: ca.SX, v: ca.SX) -> ca.SX:
        """Coriolis, centrifugal and gravity forces (nq, 1) [N m, N]."""
        return self.inverse_dynamics(q, v, ca.SX(self.nq, 1))

    def inverse_dynamics(self, q: ca.SX, v: ca.SX, a: ca.SX) -> ca.SX:
        """Force ``M(q) a + bias(q, v)`` (nq, 1) without forming M [N m, N]."""
        frames = self._frames(q)
        omega, alpha, acceleration = self._accelerations(frames, v, a)
        loads: dict[str, tuple[ca.SX, ca.SX]] = {}
        for link in self._ordered:
            name, r = link.name, frames[link.name].rotate(link.com)
            com_acceleration = acceleration[name] + alpha[name] * _swing(r)
            # The centripetal part of the force passes through the joint, so it has no moment.
            moment = link.inertia * alpha[name] + link.mass * _moment(r, com_acceleration)
            loads[name] = link.mass * (com_acceleration - omega[name] ** 2 * r), moment
        return self._generalised_forces(frames, loads) + self.armature * a

    def weight(self, q: ca.SX) -> ca.SX:
        """Force that holds the chain against gravity (nq, 1) [N m, N]."""
        return self.inverse_dynamics(q, ca.SX(self.nq, 1), ca.SX(self.nq, 1))

    def link_velocities(self, q: ca.SX, v: ca.SX) -> dict[str, ca.SX]:
        """Return, for each link, the velocity of its centre of mass and its angular velocity, ``w = J(q) v`` (3, 1)."""
        return {link.name: ca.vertcat(velocity, spin) for link, spin, velocity in self._centres(q, v)}

    def link_momenta(self, q: ca.SX, w: dict[str, ca.SX]) -> ca.SX:
        """Return momenta ``J(q)' m w`` (nq, 1) [N m s, N s] at link velocities w, with masses and inertias m."""
        frames, loads = self._frames(q), {}
        for link in self._ordered:
            linear, r = link.mass * w[link.name][:2], frames[link.name].rotate(link.com)
            loads[link.name] = linear, link.inertia * w[link.name][2] + _moment(r, linear)
        return self._generalised_forces(frames, loads)

    def potential(self, q: ca.SX) -> ca.SX:
        """Energy of gravity (zero at the origin) and of the springs [J]."""
        moment = sum(
            (link.mass * self.position(q, link.name, link.com) for link in self._ordered),
            ca.SX.zeros(2),
        )
        springs = ca.dot(self._per_coordinate(lambda link: link.spring), q**2) / 2
        return springs - ca.dot(ca.vertcat(*self.gravity), moment)

    def kinetic(self, q: ca.SX, v: ca.SX) -> ca.SX:
        """Kinetic energy ``v' M(q) v / 2`` [J]."""
        energy = ca.SX(0)
        for link, spin, velocity in self._centres(q, v):
            energy += link.mass * ca.sumsqr(velocity) + link.inertia * spin**2
        return (energy + ca.dot(self.armature, v**2)) / 2

    def energy(self, q: ca.SX, v: ca.SX) -> ca.SX:
        """Kinetic and potential energy [J]."""
        return self.kinetic(q, v) + self.potential(q)

    def momentum(self, q: ca.SX, v: ca.SX) -> ca.SX:
        """Linear momentum (2, 1) [N s]."""
        total = ca.SX.zeros(2)
        for link, _, velocity in self._centres(q, v):
            total += link.mass * velocity
        return total

    def _generalised_forces(self, frames: dict[str, _Frame], loads: dict[str, tuple[ca.SX, ca.SX]]) -> ca.SX:
        """Return generalised forces (nq, 1) from a force on each link and its moment about the joint."""
        force = {link.name: ca.SX.zeros(2) for link in self._ordered}
        moment = {link.name: ca.SX(0) for link in self._ordered}
        result = ca.SX.zeros(self.nq)
        for link in reversed(self._ordered):
            name = link.name
            moment[name] += loads[name][1]
            force[name] += loads[name][0]
            for index, motion in self._motions(name, frames):
                result[index] = motion.rotation * moment[name] + motion.direction.T @ force[name]
            if link.parent is not None:
                force[link.parent] += force[name]
                moment[link.parent] += moment[name] + _moment(frames[name].step, force[name])
        return result

    @cached_property
    def armature(self) -> ca.SX:
        """Inertia of the rotors (nq, 1) [kg m², kg]."""
        return ca.sparsify(self._per_coordinate(lambda link: link.armature))

    def _per_coordinate(self, value: Callable[[Link], Number]) -> ca.SX:
        return ca.vertcat(*(ca.SX(value(link)) for link in self._links.values() for _ in _coordinates(link)))

    def _link_frames(self, q: ca.SX) -> dict[str, _Frame]:
        frames: dict[str, _Frame] = {}
        for link in self._ordered:
            base = frames[link.parent] if link.parent is not None else _WORLD
            index = self._first[link.name]
            step, angle = base.rotate(link.anchor), base.angle + link.offset
            if link.joint == "hinge":
                angle += q[index]
            elif link.joint == "slide":
                step += base.rotate(link.axis) * q[index]
            else:
                step, angle = step + q[index : index + 2], angle + q[index + 2]
            frames[link.name] = _Frame(base.position + step, angle, step)
        return frames

    def _motions(self, name: str, frames: dict[str, _Frame]) -> list[tuple[int, _Motion]]:
        link, index = self._links[name], self._first[name]
        no_motion = ca.SX(2, 1)
        if link.joint == "hinge":
            return [(index, _Motion(1.0, no_motion))]
        if link.joint == "slide":
            base = frames[link.parent] if link.parent is not None else _WORLD
            return [(index, _Motion(0.0, base.rotate(link.axis)))]
        return [
            (index, _Motion(0.0, ca.SX([1, 0]))),
            (index + 1, _Motion(0.0, ca.SX([0, 1]))),
            (index + 2, _Motion(1.0, no_motion)),
        ]

    def _composites(self, frames: dict[str, _Frame]) -> dict[str, tuple[ca.SX, ca.SX, ca.SX]]:
        """Return, for each link with its descendants, the mass, and first and second moments about the link's joint."""
        bodies = {}
        for link in self._ordered:
            x, z = link.com
            inertia = link.inertia + link.mass * (x * x + z * z)
            bodies[link.name] = (
                ca.SX(link.mass),
                link.mass * frames[link.name].rotate(link.com),
                ca.SX(inertia),
            )
        for link in reversed(self._ordered):
            if link.parent is None:
                continue
            mass, first, second = bodies[link.name]
            step = frames[link.name].step
            x, z = link.anchor
            square = ca.SX(x * x + z * z) if link.joint == "hinge" else ca.sumsqr(step)
            above = bodies[link.parent]
            bodies[link.parent] = (
                above[0] + mass,
                above[1] + first + mass * step,
                above[2] + second + 2 * ca.dot(step, first) + mass * square,
            )
        return bodies

    def _centres(self, q: ca.SX, v: ca.SX) -> Iterator[tuple[Link, ca.SX, ca.SX]]:
        """Yield each link, its angular velocity and the velocity of its centre of mass."""
        frames = self._frames(q)
        omega: dict[str, ca.SX] = {}
        velocity: dict[str, ca.SX] = {}
        for link in self._ordered:
            spin, origin_velocity = ca.SX(0), ca.SX(2, 1)
            if link.parent is not None:
                spin = omega[link.parent]
                origin_velocity = velocity[link.parent] + spin * _swing(frames[link.name].step)
            for index, motion in self._motions(link.name, frames):
                spin = spin + motion.rotation * v[index]
                origin_velocity = origin_velocity + motion.direction * v[index]
            omega[link.name], velocity[link.name] = spin, origin_velocity
            yield link, spin, origin_velocity + spin * _swing(frames[link.name].rotate(link.com))

    def _accelerations(
        self, frames: dict[str, _Frame], v: ca.SX, a: ca.SX
    ) -> tuple[dict[str, ca.SX], dict[str, ca.SX], dict[str, ca.SX]]:
        """Return angular velocity and acceleration of each link, and its origin's acceleration minus gravity."""
        omega: dict[str, ca.SX] = {}
        alpha: dict[str, ca.SX] = {}
        acceleration: dict[str, ca.SX] = {}
        for link in self._ordered:
            spin, spin_rate = ca.SX(0), ca.SX(0)
            origin_acceleration = ca.vertcat(-self.gravity[0], -self.gravity[1])
            step = frames[link.name].step
            base = ca.SX(0)
            if link.parent is not None:
                spin, spin_rate = omega[link.parent], alpha[link.parent]
                base = spin
                origin_acceleration = acceleration[link.parent] + spin_rate * _swing(step) - spin**2 * step
            for index, motion in self._motions(link.name, frames):
                spin = spin + motion.rotation * v[index]
                spin_rate = spin_rate + motion.rotation * a[index]
                origin_acceleration = origin_acceleration + motion.direction * a[index]
                origin_acceleration = origin_acceleration + 2 * base * v[index] * _swing(motion.direction)
            omega[link.name], alpha[link.name], acceleration[link.name] = spin, spin_rate, origin_acceleration
        return omega, alpha, acceleration


def _coordinates(link: Link) -> list[Signal]:
    if link.joint == "hinge":
        return [Signal(link.name, "rad", f"angle of {link.name} in its joint")]
    if link.joint == "slide":
        return [Signal(link.name, "m", f"travel of {link.name} along its joint")]
    return [
        Signal(f"{link.name}_x", "m", f"forward position of {link.name}"),
        Signal(f"{link.name}_z", "m", f"height of {link.name}"),
        Signal(f"{link.name}_angle", "rad", f"angle of {link.name}"),
    ]
