"""Geoms of a compiled file as parts in space, and which of them may touch."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from dynamics.systems.space import (
    Box,
    Capsule,
    Cylinder,
    Hull,
    Plane,
    Shape,
    SpatialPart,
    Sphere,
)  # fmt: skip
from dynamics.systems.space.machine import WORLD
from problems.robots.bodies import Pose, SpatialTree, point, quaternion, turn_of
from problems.robots.pairs import GROUND_FRICTION, Kind, geom_names, pairs_of
from problems.robots.reach import Reach

MOST_CORNERS = 32
"""Corners that are kept of a mesh."""
_DIRECTIONS = 1000
_NAMED = 3
"""Pairs that are named where many are left out."""


@dataclass(frozen=True)
class Solids:
    """Parts, Coulomb's coefficient of each meeting, and what of the file touches nothing.

    ``geoms`` are those of the file that may touch anything.
    """

    parts: tuple[SpatialPart, ...]
    friction: dict[tuple[str, str], float]
    geoms: tuple[int, ...]
    ignored: tuple[str, ...]


def solids(model: Any, tree: SpatialTree, *, urdf: bool) -> Solids:
    """Take over all geoms that may touch another, and the pairs that can meet at all.

    A pair may as in the file, see :func:`~problems.robots.pairs.pairs_of`. Below a ``urdf`` lies
    the ground.
    """
    names, pairs, ignored = geom_names(model), pairs_of(model), list[str]()
    reach = Reach(tree.bodies)
    wanted = {(names[a], names[b]): friction for (a, b), friction in pairs.items()}
    geoms = sorted({g for pair in pairs for g in pair})
    found: dict[str, SpatialPart] = {}
    if urdf:
        geoms = np.flatnonzero(model.geom_contype | model.geom_conaffinity).tolist()
        found["ground"] = SpatialPart("ground", WORLD, Plane())
        wanted |= {
            (names[g], "ground"): max(GROUND_FRICTION, float(model.geom_friction[g][0]))
            for g in geoms if model.body_weldid[model.geom_bodyid[g]]
        }  # fmt: skip
    for g in range(model.ngeom):
        carrier = tree.carriers[int(model.geom_bodyid[g])]
        if g not in geoms and int(model.geom_type[g]) >= Kind.MESH:
            continue
        try:
            shape, told = _shape(model, g, names[g], carrier.pose)
            if isinstance(shape, Plane) and carrier.name != WORLD:
                raise ValueError("it is a plane that moves")
            found[names[g]] = SpatialPart(names[g], carrier.name, shape)
        except ValueError as error:
            told = [f"geom {names[g]}: {error}, so it touches nothing here"] if g in geoms else []
        ignored += told
    friction: dict[tuple[str, str], float] = {}
    left: dict[str, list[str]] = defaultdict(list)
    for (a, b), coefficient in wanted.items():
        if a not in found or b not in found:
            continue
        # A part of the world comes last.
        one, other = (found[b], found[a]) if found[a].body == WORLD else (found[a], found[b])
        kinds = sorted(type(part.shape).__name__.lower() for part in (one, other))
        if not _known(one.shape, other.shape):
            left[f"a {kinds[0]} and a {kinds[1]} never touch here"].append(f"{a} and {b}")
        elif reach.apart(one, other):
            left["can never meet within the joints' limits"].append(f"{a} and {b}")
        else:
            friction[one.name, other.name] = coefficient
    for why, own in left.items():
        more = f" and {len(own) - _NAMED} more" if len(own) > _NAMED else ""
        many = "" if len(own) == 1 else "s"
        ignored.append(f"{len(own)} pair{many} of geoms, {', '.join(own[:_NAMED])}{more}: {why}")
    return Solids(tuple(found.values()), friction, tuple(geoms), tuple(ignored))


def _known(one: Shape, other: Shape) -> bool:
    """Whether the contact of two shapes is known."""
    if isinstance(one, Plane) or isinstance(other, Plane):
        return not (isinstance(one, Plane) and isinstance(other, Plane))
    if isinstance(one, Hull) or isinstance(other, Hull):
        return False
    return isinstance(one, Sphere | Capsule) or isinstance(other, Sphere | Capsule)


def _shape(model: Any, g: int, name: str, carrier: Pose) -> tuple[Shape, list[str]]:
    """A geom in the frame of its body, and what of it is left out.

    Raises ``ValueError`` where no shape is like it, with the reason.
    """
    kind, size = Kind(int(model.geom_type[g])), model.geom_size[g]
    pose = carrier @ Pose(model.geom_pos[g], turn_of(model.geom_quat[g]))
    along, radius = pose.turn.as_matrix()[:, 2], float(size[0])
    ends = point(pose.place - size[1] * along), point(pose.place + size[1] * along)
    match kind:
        case Kind.PLANE:
            return Plane(point(pose.place), point(along)), []
        case Kind.CAPSULE:
            return Capsule(*ends, radius), []
        case Kind.CYLINDER:
            return Cylinder(*ends, radius), []
        case Kind.BOX:
            return Box(tuple(size.tolist()), point(pose.place), quaternion(pose.turn)), []
        case Kind.MESH:
            mesh = int(model.geom_dataid[g])
            first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
            corners, all_of_them, depth = _corners(model.mesh_vert[first : first + count])
            told = (
                f"hull of mesh {name}: {len(corners)} of {all_of_them} corners, at most"
                f" {1e3 * depth:.2g} mm inside"
            )
            points = tuple(point(pose.place + at) for at in pose.turn.apply(corners))
            return Hull(points), [told] if len(corners) < all_of_them else []
        case Kind.SPHERE | Kind.ELLIPSOID if kind == Kind.SPHERE or len(set(size.tolist())) == 1:
            return Sphere(radius, point(pose.place)), []
    raise ValueError(f"it is a {kind.name.lower()}".replace("a e", "an e"))


def _corners(vertices: np.ndarray) -> tuple[np.ndarray, int, float]:
    """Corners (n, 3) of a convex hull that reach furthest, of how many, and by how much too short.

    One by one those are kept that a grid of directions misses most. Raises ``ValueError`` for flat.
    """
    try:
        corners = vertices[ConvexHull(vertices).vertices].astype(float)
    except QhullError:
        raise ValueError("it is a flat mesh") from None
    if len(corners) <= MOST_CORNERS:
        return corners, len(corners), 0.0
    # Fibonacci's spiral on the sphere.
    k = np.arange(_DIRECTIONS) + 0.5
    z, angle = 1 - 2 * k / _DIRECTIONS, np.pi * (1 + 5**0.5) * k
    across = np.sqrt(1 - z**2)
    reach = corners @ np.array([across * np.cos(angle), across * np.sin(angle), z])
    kept = [int(reach[:, 0].argmax())]
    while True:
        short = reach.max(axis=0) - reach[kept].max(axis=0)
        worst = int(short.argmax())
        if len(kept) == MOST_CORNERS or short[worst] <= 0:
            return corners[kept], len(corners), float(short[worst])
        kept.append(int(reach[:, worst].argmax()))
