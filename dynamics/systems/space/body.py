"""Rigid bodies in space and their joints."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import casadi as ca

from dynamics.systems.checks import (
    parse_number,
    require_limits,
    require_not_negative,
    require_text,
    require_unit_vector,
)
from dynamics.systems.parameters import Signal

Number = float | ca.SX
Vector = tuple[Number, Number, Number]
Quaternion = tuple[Number, Number, Number, Number]
Joint = Literal["free", "ball", "hinge", "slide", "fixed"]
POSITIONS = {"free": 7, "ball": 4, "hinge": 1, "slide": 1, "fixed": 0}
VELOCITIES = {"free": 6, "ball": 3, "hinge": 1, "slide": 1, "fixed": 0}
"""Number of entries of each kind of joint in q (``POSITIONS``) and in v (``VELOCITIES``)."""


@dataclass(frozen=True, eq=False)
class Body:
    """A rigid body in space and the joint to its parent; every number may be a CasADi symbol.

    The body's frame has its origin in the joint. At q = 0 (for a ball, at the quaternion 1) it is at
    ``position`` [m], rotated by the unit ``quaternion`` (w, x, y, z), in the frame of ``parent``; None is the world.
    z points up.

    ``mass`` [kg], which may be zero for a body with children; ``inertia`` about the centre of mass
    in the body's axes, (xx, yy, zz) or (xx, yy, zz, xy, xz, yz) [kg m²]; ``com`` the position of
    that centre [m].

    ``joint``: a ``hinge`` turns about ``axis``, a unit vector of the body's frame, by q [rad]; a ``slide``
    moves along ``axis`` by q [m]; a ``ball`` has a unit quaternion, and its angular velocity in the body's axes
    [rad/s]; ``free`` has the position in the world [m] and a quaternion, the velocity of the origin in the
    world's axes [m/s] and an angular velocity in the body's axes (both velocities at the previous pose in a
    step, see :func:`~dynamics.systems.space.stepping.centre_velocities`); ``fixed`` has no coordinates.
    ``spring`` and ``damping`` act in hinges and slides (damping in all joints), the spring at rest at ``rest``
    [N m/rad, N m s/rad; N/m, N s/m]; ``gear``, ``limits`` and ``armature`` as in
    :class:`~dynamics.systems.Link`. ``servo`` is the stiffness [N m/rad; N/m] of a motor whose input is its
    target position.

    Raises ``ValueError`` for an invalid argument: a negative mass or inertia, inertia that violates
    the triangle inequality, an axis or quaternion not of unit length, reversed limits, and a setting
    that the kind of joint does not have.
    """

    name: str
    parent: str | None
    mass: Number
    inertia: tuple[Number, ...] = (0.0, 0.0, 0.0)
    com: Vector = (0.0, 0.0, 0.0)
    position: Vector = (0.0, 0.0, 0.0)
    quaternion: Quaternion = (1.0, 0.0, 0.0, 0.0)
    joint: Joint = "hinge"
    axis: Vector = (0.0, 1.0, 0.0)
    spring: Number = 0.0
    rest: Number = 0.0
    damping: Number = 0.0
    gear: Number | None = None
    servo: Number | None = None
    limits: tuple[Number, Number] | None = None
    armature: Number = 0.0

    def __post_init__(self) -> None:
        require_text("the name of a body", self.name)
        owner = f"body {self.name!r}:"
        require_not_negative(f"{owner} mass", self.mass)
        lengths = {"inertia": (3, 6), "com": (3,), "position": (3,), "quaternion": (4,), "axis": (3,)}
        vectors = {a: require_vector(f"{owner} {a}", getattr(self, a), sizes) for a, sizes in lengths.items()}
        for attribute in ("spring", "rest", "damping"):
            parse_number(f"{owner} {attribute}", getattr(self, attribute))
        require_not_negative(f"{owner} armature", self.armature)
        if self.joint not in get_args(Joint):
            kinds = ", ".join(map(repr, get_args(Joint)))
            raise ValueError(f"{owner} joint must be one of {kinds}, got {self.joint!r}")
        self._check_inertia(owner)
        for attribute in ("quaternion", "axis"):
            require_unit_vector(f"{owner} {attribute}", vectors[attribute])
        self._check_joint(owner)

    @property
    def inertia_matrix(self) -> ca.SX:
        """Inertia about the centre of mass (3, 3) in the body's axes [kg m²]."""
        xx, yy, zz, xy, xz, yz = (*self.inertia, 0, 0, 0)[:6]
        rows = (xx, xy, xz), (xy, yy, yz), (xz, yz, zz)
        return ca.sparsify(ca.vertcat(*(ca.SX(ca.horzcat(*row)) for row in rows)))

    @property
    def positions(self) -> list[Signal]:
        """Names and units of the joint's entries of q."""
        name = self.name
        if self.joint in ("hinge", "slide"):
            unit, quantity = ("rad", "angle") if self.joint == "hinge" else ("m", "travel")
            return [Signal(name, unit, f"{quantity} of {name} in its joint")]
        position = [Signal(f"{name}_{a}", "m", f"position of {name} along {a}") for a in "xyz"]
        quaternion = [Signal(f"{name}_q{a}", "1", f"quaternion of {name}") for a in "wxyz"]
        return {"free": position + quaternion, "ball": quaternion, "fixed": []}[self.joint]

    @property
    def velocities(self) -> list[Signal]:
        """Names and units of the joint's entries of v."""
        name = self.name
        if self.joint in ("hinge", "slide"):
            unit = "rad/s" if self.joint == "hinge" else "m/s"
            return [Signal(f"v_{name}", unit, f"velocity of {name}")]
        linear = [Signal(f"v_{name}_{a}", "m/s", f"velocity of {name} along {a}") for a in "xyz"]
        spin = [Signal(f"w_{name}_{a}", "rad/s", f"angular velocity of {name} about its {a}") for a in "xyz"]
        return {"free": linear + spin, "ball": spin, "fixed": []}[self.joint]

    def _check_inertia(self, owner: str) -> None:
        moments = [parse_number(f"{owner} inertia[{i}]", value) for i, value in enumerate(self.inertia[:3])]
        known_moments = [value for value in moments if value is not None]
        if any(value < 0 for value in known_moments):
            raise ValueError(f"{owner} inertia must not be negative, got {known_moments}")
        if len(known_moments) == 3 and 2 * max(known_moments) > sum(known_moments) * (1 + 1e-6):
            raise ValueError(
                f"{owner} inertia {known_moments} is impossible: no moment is larger than the sum of the other two"
            )

    def _check_joint(self, owner: str) -> None:
        require_limits(owner, self.limits)
        has_one_axis = self.joint in ("hinge", "slide")
        unsupported = [attribute for attribute in ("gear", "servo", "limits") if getattr(self, attribute) is not None]
        unsupported += [
            attribute for attribute in ("spring", "armature") if not ca.SX(getattr(self, attribute)).is_zero()
        ]
        if unsupported and not has_one_axis:
            raise ValueError(
                f"{owner} a {self.joint} joint has no {unsupported[0]}; leave it out, or take a hinge or a slide"
            )
        if self.gear is not None and self.servo is not None:
            raise ValueError(f"{owner} gear and servo are two kinds of motor; give one of them")
        if self.joint == "free" and self.parent is not None:
            raise ValueError(f"{owner} it floats freely, so it has no parent; leave parent out")


def require_vector(name: str, value: object, sizes: tuple[int, ...]) -> list[float | None]:
    """Return the entries of a tuple of numbers, None for symbolic entries; raise ``ValueError`` for other ``sizes``."""
    if not isinstance(value, tuple) or len(value) not in sizes:
        counts = " or ".join(map(str, sizes))
        raise ValueError(f"{name} must be a tuple of {counts} numbers, got {value!r}")
    return [parse_number(f"{name}[{i}]", entry) for i, entry in enumerate(value)]
