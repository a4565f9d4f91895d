"""What stands in a scene: bodies, pushers, obstacles and goals, each with its shape."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from dynamics.systems import Signal
from dynamics.systems.contacts import Pose, Shape
from dynamics.systems.contacts.shapes import Point, Scalar, column

_AXES = ("x", "y")


@dataclass(frozen=True, eq=False)
class Thing:
    """A ``shape`` called ``name``, at ``at`` [m], turned anticlockwise by ``angle`` [rad].

    The shape lies in the thing's own frame, whose origin is at ``at``.
    """

    name: str
    shape: Shape
    at: Point
    angle: Scalar = 0.0

    @property
    def coordinates(self) -> tuple[Signal, ...]:
        """How it moves; nothing moves an obstacle."""
        return ()

    @property
    def turns(self) -> bool:
        """Whether its angle may change."""
        return False

    @property
    def start(self) -> ca.SX:
        """The coordinates where it starts."""
        return ca.SX(0, 1)

    def pose(self, q: ca.SX) -> Pose:
        """Where it is at its own coordinates ``q``."""
        return Pose(column(self.at), -ca.SX(self.angle))


class Obstacle(Thing):
    """What never moves."""


@dataclass(frozen=True, eq=False)
class Body(Thing):
    """What moves freely, with coordinates x, y [m], and an angle [rad] where it has an ``inertia``.

    ``mass`` [kg]; ``inertia`` [kg m²] about the origin of its frame, which is its centre of mass,
    None for a body that never turns.
    """

    mass: Scalar = 1.0
    inertia: Scalar | None = None

    @property
    def coordinates(self) -> tuple[Signal, ...]:
        """``<name>_x``, ``<name>_y`` and, where it turns, ``<name>_angle``."""
        found = _places(self.name)
        turn = Signal(f"{self.name}_angle", "rad", f"{self.name}, anticlockwise")
        return (*found, turn) if self.turns else found

    @property
    def turns(self) -> bool:
        """Whether it has an inertia."""
        return self.inertia is not None

    @property
    def start(self) -> ca.SX:
        """``at`` and, where it turns, ``angle``."""
        return ca.vertcat(column(self.at), self.angle) if self.turns else column(self.at)

    def pose(self, q: ca.SX) -> Pose:
        """Where it is at its own coordinates ``q``."""
        return Pose(q[:2], -ca.SX(q[2] if self.turns else self.angle))


@dataclass(frozen=True, eq=False)
class Pusher(Thing):
    """What a motor moves; it never turns.

    In a quasi-dynamic scene a spring of ``stiffness`` [N/m] draws it to the commanded place, in one
    with velocities it has a ``mass`` [kg] and is pushed by a force. It moves in the plane, or on a
    rail along the unit vector ``axis``, with the way gone from ``at`` [m] as its one coordinate.
    """

    stiffness: Scalar | None = None
    mass: Scalar | None = None
    axis: Point | None = None

    @property
    def coordinates(self) -> tuple[Signal, ...]:
        """``<name>_x`` and ``<name>_y``, or the way gone ``<name>``."""
        if self.axis is None:
            return _places(self.name)
        return (Signal(self.name, "m", f"way of {self.name} along its rail"),)

    @property
    def start(self) -> ca.SX:
        """``at``, or no way gone."""
        return column(self.at) if self.axis is None else ca.SX.zeros(1)

    def pose(self, q: ca.SX) -> Pose:
        """Where it is at its own coordinates ``q``."""
        place = q if self.axis is None else column(self.at) + q * column(self.axis)
        return Pose(place, -ca.SX(self.angle))

    @property
    def directions(self) -> ca.SX:
        """Unit vectors in which its coordinates move it, as columns."""
        return ca.SX.eye(2) if self.axis is None else column(self.axis)


@dataclass(frozen=True, eq=False)
class Goal:
    """Where the body called ``body`` should come to, drawn in its shape; nothing touches it."""

    body: str
    at: Point
    angle: Scalar = 0.0


def _places(name: str) -> tuple[Signal, ...]:
    return tuple(Signal(f"{name}_{axis}", "m", name) for axis in _AXES)
