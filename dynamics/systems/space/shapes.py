"""Shapes of bodies in space, in the frame of their body."""

from __future__ import annotations

from dataclasses import dataclass

from dynamics.systems.checks import require_not_negative, require_positive, require_unit_vector
from dynamics.systems.space.body import Number, Quaternion, Vector, require_vector


@dataclass(frozen=True, eq=False)
class Sphere:
    """A sphere: all points within ``radius`` [m] of ``centre``; the radius 0 gives a point."""

    radius: Number
    centre: Vector = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        require_not_negative("Sphere radius", self.radius)
        require_vector("Sphere centre", self.centre, (3,))


@dataclass(frozen=True, eq=False)
class Capsule:
    """A capsule: all points within ``radius`` [m] of the segment from ``start`` to ``end``."""

    start: Vector
    end: Vector
    radius: Number

    def __post_init__(self) -> None:
        require_positive("Capsule radius", self.radius)
        require_vector("Capsule start", self.start, (3,))
        require_vector("Capsule end", self.end, (3,))


@dataclass(frozen=True, eq=False)
class Cylinder:
    """A cylinder of ``radius`` [m] whose axis runs from ``start`` to ``end``."""

    start: Vector
    end: Vector
    radius: Number

    def __post_init__(self) -> None:
        require_positive("Cylinder radius", self.radius)
        require_vector("Cylinder start", self.start, (3,))
        require_vector("Cylinder end", self.end, (3,))


@dataclass(frozen=True, eq=False)
class Box:
    """A box with half sides ``half_size`` [m] around ``centre``, rotated by a unit quaternion."""

    half_size: Vector
    centre: Vector = (0.0, 0.0, 0.0)
    quaternion: Quaternion = (1.0, 0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        require_vector("Box half_size", self.half_size, (3,))
        require_positive("Box half_size", *self.half_size)
        require_vector("Box centre", self.centre, (3,))
        require_unit_vector("Box quaternion", require_vector("Box quaternion", self.quaternion, (4,)))


@dataclass(frozen=True, eq=False)
class Hull:
    """The convex hull of ``points`` [m], such as the vertices of a mesh."""

    points: tuple[Vector, ...]

    def __post_init__(self) -> None:
        for i, vertex in enumerate(self.points):
            require_vector(f"Hull points[{i}]", vertex, (3,))


@dataclass(frozen=True, eq=False)
class Plane:
    """The half-space below the plane through ``origin`` with the outward unit ``normal``."""

    origin: Vector = (0.0, 0.0, 0.0)
    normal: Vector = (0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        require_vector("Plane origin", self.origin, (3,))
        require_unit_vector("Plane normal", require_vector("Plane normal", self.normal, (3,)))


Shape = Sphere | Capsule | Cylinder | Box | Hull | Plane
