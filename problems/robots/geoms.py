"""Conversion of the geoms of a compiled file to parts in space, and the pairs of geoms that may touch."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from itertools import combinations, starmap
from typing import Any

import casadi as ca
import numpy as np
from scipy.spatial import ConvexHull

from dynamics.systems.space import (
    WORLD,
    Box,
    Capsule,
    Cylinder,
    Hull,
    Plane,
    Shape,
    SpatialMachine,
    SpatialPart,
    Sphere,
)
from dynamics.systems.space.contact import contacts_between
from dynamics.systems.space.machine import body_places, distinct_points, name_contacts
from problems.robots.bodies import BodyFrame, exact
from problems.robots.reach import joints_above, never_collide

MOST_CORNERS = 32
"""Maximum number of corners of a mesh's hull."""
MOST_PAIRS = 10_000
"""Maximum number of pairs of geoms that may touch."""
PAIRS_NAMED = 3
"""Maximum number of pairs of geoms in a sentence about ignored pairs."""
CONTACT_DISABLED = 1 << 4
"""Bit of MuJoCo's ``disableflags`` that disables contact."""
PARENT_FILTER_DISABLED = 1 << 10
"""Bit of MuJoCo's ``disableflags`` that lets a body touch its parent."""


@dataclass(frozen=True)
class CollisionModel:
    """A machine with its parts and contacts.

    ``distances`` maps q (nq, 1) to the signed distance of every contact (nc, 1) [m], ``friction`` the
    name of a contact to Coulomb's coefficient. ``grounds`` are the indices of contacts with level
    ground, ``geoms`` the numbers of geoms that may touch, ``ignored`` sentences about ignored geoms and pairs.
    """

    machine: SpatialMachine
    distances: ca.Function
    friction: dict[str, float]
    grounds: list[int]
    geoms: list[int]
    ignored: list[str]


def collision_model(model: Any, machine: SpatialMachine, poses: Sequence[BodyFrame]) -> CollisionModel:
    """Return a machine with all geoms of supported shapes, and the pairs of geoms that can touch each other.

    Raises ``ValueError`` for too many pairs, and for two contacts of the same name.
    """
    pairs, ignored, data = pairs_of(model), list[str](), import_module("mujoco").MjData(model)
    if len(pairs) > MOST_PAIRS:
        raise ValueError(
            f"{len(pairs)} pairs of geoms may touch; at most {MOST_PAIRS} are read; exclude"
            " some by contype, conaffinity or exclude"
        )
    geoms = sorted({g for pair in pairs for g in pair})
    parts = _parts(model, poses, geoms, ignored)
    machine = replace(machine, parts=tuple(parts.values()))
    tree, left_out = machine.tree(), defaultdict[str, list[str]](list)
    q = ca.SX.sym("q", tree.nq)
    above, body_poses = joints_above(model), body_places(tree, q)
    friction, grounds, collision_pairs = dict[str, float](), list[int](), list[tuple[str, str]]()
    phis = [ca.SX(0, 1)]
    for (a, b), coefficient in pairs.items():
        if a not in parts or b not in parts:
            continue
        # In a pair with a part of the world, that part comes second.
        first, second = (parts[g] for g in ((b, a) if parts[a].body == WORLD else (a, b)))
        pair = first.name, second.name
        try:
            points = contacts_between(first.shape, body_poses[first.body], second.shape, body_poses[second.body])
        except ValueError as error:
            left_out[str(error)].append(" and ".join(pair))
            continue
        distinct = distinct_points(tree, q, first.placed, second.placed, len(points))
        named_contacts = name_contacts(*pair, [points[k] for k in distinct])
        if duplicates := friction.keys() & named_contacts.keys():
            raise ValueError(f"two contacts are called {min(duplicates)!r}; give the geoms other names")
        if not any(ca.depends_on(contact.phi, q) for contact in named_contacts.values()):
            left_out["no joint moves them"].append(" and ".join(pair))
        elif never_collide(model, data, above, a, b):
            left_out["they can never meet within the joints' limits"].append(" and ".join(pair))
        else:
            if isinstance(second.shape, Plane) and second.shape.normal[2] == 1:
                grounds += range(len(friction), len(friction) + len(named_contacts))
            friction |= dict.fromkeys(named_contacts, coefficient)
            collision_pairs.append(pair)
            phis += [contact.phi for contact in named_contacts.values()]
    machine = replace(machine, collision_pairs=tuple(collision_pairs))
    distances = ca.Function("distances", [q], [ca.densify(ca.vertcat(*phis))])
    return CollisionModel(
        machine, distances, friction, grounds, geoms, [*ignored, *starmap(_omission, left_out.items())]
    )


def _omission(reason: str, pair_names: list[str]) -> str:
    """Return a sentence about pairs of geoms that are left out for the same reason."""
    unlisted = f" and {len(pair_names) - PAIRS_NAMED} more" if len(pair_names) > PAIRS_NAMED else ""
    plural = "" if len(pair_names) == 1 else "s"
    return f"{len(pair_names)} pair{plural} of geoms, {', '.join(pair_names[:PAIRS_NAMED])}{unlisted}: {reason}"


def _parts(model: Any, poses: Sequence[BodyFrame], geoms: list[int], ignored: list[str]) -> dict[int, SpatialPart]:
    """Return a mapping from geom to part; append notes on omissions and changes among ``geoms`` to ``ignored``."""
    parts: dict[int, SpatialPart] = {}
    for g in range(model.ngeom):
        name, note = model.geom(g).name, ""
        pose = poses[model.geom_bodyid[g]].compose(model.geom_pos[g], model.geom_quat[g])
        kind = import_module("mujoco").mjtGeom(int(model.geom_type[g])).name[7:].lower()
        try:
            shape, note = _shape(model, g, kind, pose)
            parts[g] = SpatialPart(name, pose.body, shape)
        except ValueError as error:
            note = f"geom {name}: it is {error}, and has no contacts here"
        ignored += [note] if note and g in geoms else []
    return parts


def _shape(model: Any, g: int, kind: str, pose: BodyFrame) -> tuple[Shape, str]:
    """Return the shape of a geom in the frame of its body, and a note on omitted features ("" if none).

    Raises ``ValueError`` with the reason if the geom's shape is not supported.
    """
    size, middle = model.geom_size[g], exact(pose.origin)
    R, radius = pose.rotation.as_matrix(), float(size[0])
    if kind == "plane" and pose.body == WORLD:
        return Plane(middle, exact(R[:, 2])), ""
    if kind == "sphere" or (kind == "ellipsoid" and len(set(size.tolist())) == 1):
        return Sphere(radius, middle), ""
    if kind in ("capsule", "cylinder"):
        start, end = (exact(pose.origin + side * size[1] * R[:, 2]) for side in (-1, 1))
        return (Capsule if kind == "capsule" else Cylinder)(start, end, radius), ""
    if kind == "box":
        straight = np.abs(R).round()
        if np.allclose(np.abs(R), straight, atol=1e-12):
            return Box(exact(straight @ size), middle), ""
        return Box(exact(size), middle, exact(pose.rotation.as_quat(scalar_first=True))), ""
    if kind == "mesh":
        return _hull(model, g, pose)
    raise ValueError(f"of the kind {kind}")


def _hull(model: Any, g: int, pose: BodyFrame) -> tuple[Hull, str]:
    """Return the hull of the corners that MuJoCo stores, and a note on its largest distance inside the mesh."""
    mesh = int(model.geom_dataid[g])
    first, n_vertices = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    corners = model.mesh_vert[first : first + n_vertices].astype(float)
    start = int(model.mesh_graphadr[mesh])
    count = 0 if start < 0 else int(model.mesh_graph[start])
    if not 0 < count <= MOST_CORNERS:
        raise ValueError(f"a mesh without a hull of at most {MOST_CORNERS} corners")
    kept_corners = corners[model.mesh_graph[start + 2 + count : start + 2 + 2 * count]]
    faces = ConvexHull(kept_corners).equations
    depth = 1e3 * float((corners @ faces[:, :3].T + faces[:, 3]).max())
    note = f"hull of mesh {model.geom(g).name}: {count} corners, at most {depth:.2g} mm inside"
    hull = Hull(tuple(exact(pose.origin + corner) for corner in pose.rotation.apply(kept_corners)))
    return hull, note if depth > 1e-3 else ""


def pairs_of(model: Any) -> dict[tuple[int, int], float]:
    """Return a mapping from pairs of geoms that may touch to Coulomb's coefficient, 0 without friction.

    These are the pairs that the file lists, and the pairs that contype and conaffinity allow, unless the
    two bodies are excluded, fixed to each other, or parent and child.
    """
    if model.opt.disableflags & CONTACT_DISABLED:
        return {}
    coefficients: dict[tuple[int, int], float] = {}
    for k in range(model.npair):
        first, second = model.pair_friction[k][:2]
        if first != second and model.pair_dim[k] > 1:
            raise ValueError(
                f"contact pair {model.pair(k).name or k + 1!r} has the friction {first:g} and"
                f" {second:g}; friction here is the same in all directions, so give one number"
            )
        a, b = sorted((int(model.pair_geom1[k]), int(model.pair_geom2[k])))
        coefficients[a, b] = float(model.pair_friction[k][0]) if model.pair_dim[k] > 1 else 0.0
    excluded = {frozenset(divmod(int(code), 1 << 16)) for code in model.exclude_signature}
    types, affinities, body = model.geom_contype, model.geom_conaffinity, model.geom_bodyid
    weld = model.body_weldid[body]
    above = model.body_weldid[model.body_parentid[weld]]
    kin = not model.opt.disableflags & PARENT_FILTER_DISABLED
    for a, b in combinations(range(model.ngeom), 2):
        joined = weld[a] and weld[b] and (weld[a] == above[b] or weld[b] == above[a]) and kin
        if weld[a] == weld[b] or joined or frozenset(body[[a, b]].tolist()) in excluded:
            continue
        if types[a] & affinities[b] or types[b] & affinities[a]:
            coefficients.setdefault((a, b), _friction(model, a, b))
    return coefficients


def _friction(model: Any, a: int, b: int) -> float:
    """Return the friction coefficient of the geom of higher priority, or the larger one if priorities are equal."""
    ranks = model.geom_priority[[a, b]]
    deciding = [a, b] if ranks[0] == ranks[1] else [a if ranks[0] > ranks[1] else b]
    return float(model.geom_friction[deciding][:, 0].max()) if model.geom_condim[deciding].max() > 1 else 0.0
