"""Geoms of a compiled file as parts of the plane, and which of them may touch."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dynamics.systems import Part, Sphere
from dynamics.systems.contacts import Capsule, Disc, HalfPlane, Polygon, Shape
from problems.robots.pairs import GROUND_FRICTION, Kind, geom_names, pairs_of
from problems.robots.tree import TILT, Frame, clean, plane

_WORLD = "world"
Corner = tuple[str, tuple[float, float], float]
"""A disc of a geom: its name, its centre in the link's frame [m], its radius [m]."""


@dataclass(frozen=True)
class _Solid:
    """A geom in the plane: its section ``shape``, and the ``corners`` that meet planes first.

    ``depth`` is the part of the y axis in which the section is this one, less what rounds it [m].
    Where there is no section or no corner, ``fault`` says why.
    """

    name: str
    link: str
    shape: Shape | None = None
    corners: tuple[Corner, ...] = ()
    depth: tuple[float, float] = (0.0, 0.0)
    fault: str = ""


@dataclass(frozen=True)
class Touching:
    """Spheres over the ground, further parts, who meets whom, and the coefficients by contact.

    ``geoms`` are those of the file that may touch anything.
    """

    spheres: tuple[Sphere, ...]
    parts: tuple[Part, ...]
    meetings: tuple[tuple[str, str], ...]
    friction: Mapping[str, float]
    geoms: tuple[int, ...]
    ignored: tuple[str, ...]


@dataclass
class _Found:
    """What is collected pair by pair."""

    spheres: dict[str, Sphere] = field(default_factory=dict)
    points: dict[str, Part] = field(default_factory=dict)
    on_ground: dict[str, float] = field(default_factory=dict)
    meetings: dict[tuple[str, str], float] = field(default_factory=dict)
    ignored: dict[str, None] = field(default_factory=dict)

    def over(self, solid: _Solid, plane: str, level: bool, friction: float) -> None:
        """Let the corners of a solid meet a plane, which is the ground where it is ``level``."""
        if not solid.corners:
            self.ignored[f"geom {solid.name}: {solid.fault}, so it touches nothing here"] = None
        for name, centre, radius in solid.corners:
            if level and radius > 0:
                self.spheres[name] = Sphere(name, solid.link, centre, radius)
                self.on_ground[name] = max(friction, self.on_ground.get(name, 0.0))
            else:
                self.points[name] = Part(name, solid.link, Disc(radius, centre))
                self.meetings[name, plane] = friction

    def meet(self, one: _Solid, other: _Solid, friction: float) -> None:
        """Let two solids meet whose sections lie in one plane."""
        if one.shape is None or other.shape is None:
            for solid in (s for s in (one, other) if s.shape is None):
                told = f"geom {solid.name}: {solid.fault}, so it touches no other part here"
                self.ignored[told] = None
            return
        apart = max(one.depth[0], other.depth[0]) - min(one.depth[1], other.depth[1])
        if apart <= TILT:
            self.meetings[one.name, other.name] = friction
        elif apart < float(one.shape.radius) + float(other.shape.radius):
            self.ignored[
                f"geoms {one.name} and {other.name}: at different y, they never touch here"
            ] = None


def touching(model: Any, data: Any, frames: Mapping[int, Frame], *, urdf: bool) -> Touching:
    """Take over all geoms whose section in the plane is known, and the pairs that may touch.

    A pair may as in the file: by ``contype`` and ``conaffinity``, but for parent and child, and for
    what is excluded. Below a ``urdf`` lies the ground.
    """
    names, found = geom_names(model), _Found()
    links = [frames[int(model.body_weldid[body])] for body in model.geom_bodyid]
    flat = {g for g in range(model.ngeom) if model.geom_type[g] == Kind.PLANE}
    planes = {g: _half_plane(data, g, links[g]) for g in flat}
    solids = {
        g: _solid(model, data, g, names[g], links[g]) for g in range(model.ngeom) if g not in flat
    }
    pairs = pairs_of(model)
    for (a, b), friction in pairs.items():
        if not flat & {a, b}:
            # A part of the world comes last.
            one, other = (b, a) if solids[a].link == _WORLD else (a, b)
            found.meet(solids[one], solids[other], friction)
            continue
        low, other = (a, b) if a in flat else (b, a)
        half = planes[low]
        if half is None or other in flat:
            found.ignored[f"plane {names[low]}: it moves, or leans along y"] = None
        else:
            found.over(solids[other], names[low], _level(half), friction)
    grounds = {names[g]: half for g, half in planes.items() if half is not None}
    if urdf:
        grounds["ground"] = HalfPlane()
        for g, solid in solids.items():
            if solid.link != _WORLD and (model.geom_contype[g] or model.geom_conaffinity[g]):
                friction = max(GROUND_FRICTION, float(model.geom_friction[g][0]))
                found.over(solid, "ground", True, friction)
    met = {name for meeting in found.meetings for name in meeting}
    parts = {name: Part(name, _WORLD, half) for name, half in grounds.items()
             if name in met or not _level(half)}  # fmt: skip
    parts |= {s.name: Part(s.name, s.link, s.shape) for s in solids.values() if s.shape is not None}
    parts |= found.points
    kept = tuple(part for name, part in parts.items() if name not in found.spheres)
    friction = {
        **{name: found.on_ground[name] for name in found.spheres},
        **{f"{a} on {b}": f for (a, b), f in found.meetings.items()},
    }
    seen = range(model.ngeom) if urdf else sorted({g for pair in pairs for g in pair})
    return Touching(
        tuple(found.spheres.values()), kept, tuple(found.meetings), friction, tuple(seen),
        tuple(found.ignored),
    )  # fmt: skip


def _level(half: HalfPlane) -> bool:
    """Whether a half-plane is the ground z = 0."""
    return float(half.origin[1]) == 0 and float(half.normal[0]) == 0 < float(half.normal[1])


def _half_plane(data: Any, g: int, frame: Frame) -> HalfPlane | None:
    normal = data.geom_xmat[g].reshape(3, 3)[:, 2]
    if frame.link != _WORLD or abs(normal[1]) > TILT:
        return None
    up = plane(normal) / np.hypot(normal[0], normal[2])
    return HalfPlane(clean(data.geom_xpos[g][[0, 2]]), clean(up))


def _solid(model: Any, data: Any, g: int, name: str, frame: Frame) -> _Solid:
    """The section of a geom in the frame of its link."""
    kind, size, middle = int(model.geom_type[g]), model.geom_size[g], data.geom_xpos[g]
    R = data.geom_xmat[g].reshape(3, 3)
    across = [abs(R[1, k]) > 1 - TILT**2 for k in range(3)]

    def local(*steps: np.ndarray) -> tuple[float, float]:
        return clean(frame.local(plane(middle + np.sum(steps, axis=0))))

    def disc(radius: float, half: float) -> _Solid:
        centre = local()
        depth = middle[1] - half, middle[1] + half
        return _Solid(name, frame.link, Disc(radius, centre), ((name, centre, radius),), depth)

    def rectangle(a: np.ndarray, b: np.ndarray, half: float) -> _Solid:
        at = local(a, b), local(-a, b), local(-a, -b), local(a, -b)
        corners = tuple((f"{name} corner {k}", corner, 0.0) for k, corner in enumerate(at, 1))
        depth = middle[1] - half, middle[1] + half
        return _Solid(name, frame.link, Polygon(at), corners, depth)

    radius = float(size[0])
    if kind == Kind.SPHERE or (kind == Kind.ELLIPSOID and size[0] == size[1] == size[2]):
        return disc(radius, 0.0)
    if kind in (Kind.CAPSULE, Kind.CYLINDER) and across[2]:
        return disc(radius, float(size[1]))
    if kind == Kind.CAPSULE:
        ends = [local(sign * size[1] * R[:, 2]) for sign in (-1, 1)]
        corners = tuple(
            (f"{name} {end}", at, radius) for end, at in zip(("start", "end"), ends, strict=True)
        )
        if abs(R[1, 2]) > TILT:
            return _Solid(name, frame.link, None, corners, fault="it leans along y")
        depth = middle[1], middle[1]
        return _Solid(name, frame.link, Capsule(ends[0], ends[1], radius), corners, depth)
    if kind == Kind.CYLINDER and abs(R[1, 2]) <= TILT:
        along = R[:, 2]
        return rectangle(size[1] * along, radius * np.array([-along[2], 0.0, along[0]]), 0.0)
    if kind == Kind.BOX and any(across):
        k = across.index(True)
        i, j = (axis for axis in range(3) if axis != k)
        return rectangle(size[i] * R[:, i], size[j] * R[:, j], float(size[k]))
    return _Solid(name, frame.link, fault=f"it {_FAULTS.get(Kind(kind), 'is of no known kind')}")


_FAULTS = {
    Kind.ELLIPSOID: "is an ellipsoid", Kind.CYLINDER: "leans along y", Kind.BOX: "leans along y",
    Kind.MESH: "is a mesh", Kind.SDF: "is a signed distance field",
}  # fmt: skip
