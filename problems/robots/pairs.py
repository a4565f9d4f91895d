"""Names of a compiled file's geoms, and which of them may touch."""

from __future__ import annotations

from enum import IntEnum
from itertools import combinations
from typing import Any

from problems.robots.tree import body_name

GROUND_FRICTION = 1.0
"""Coulomb's coefficient of the ground below a URDF, MuJoCo's default."""
_NO_CONTACT, _PARENTS_MEET = 1 << 4, 1 << 10
"""Bits of MuJoCo's flags that turn off contact, and the filter of parents."""


class Kind(IntEnum):
    """MuJoCo's kinds of geoms."""

    PLANE, SPHERE, CAPSULE, ELLIPSOID, CYLINDER, BOX, MESH, SDF = 0, 2, 3, 4, 5, 6, 7, 8


def geom_names(model: Any) -> list[str]:
    """A name for every geom: its own, or that of its body with a number."""
    given = [model.geom(g).name for g in range(model.ngeom)]
    names: list[str] = []
    for g, name in enumerate(given):
        body = int(model.geom_bodyid[g])
        number = g - int(model.body_geomadr[body]) + 1
        name = name or f"{body_name(model, body)} geom {number}"
        while name in names or (not given[g] and name in given):
            name += "'"
        names.append(name)
    return names


def pairs_of(model: Any) -> dict[tuple[int, int], float]:
    """Pairs of geoms that may touch, with Coulomb's coefficient, 0 where they only push."""
    if model.opt.disableflags & _NO_CONTACT:
        return {}
    found = {
        tuple(sorted((int(model.pair_geom1[k]), int(model.pair_geom2[k])))): (
            float(model.pair_friction[k][0]) if model.pair_dim[k] > 1 else 0.0
        )
        for k in range(model.npair)
    }
    excluded = {
        frozenset((int(code) >> 16, int(code) & 0xFFFF)) for code in model.exclude_signature
    }
    for a, b in combinations(range(model.ngeom), 2):
        bodies = int(model.geom_bodyid[a]), int(model.geom_bodyid[b])
        if frozenset(bodies) not in excluded and _meet(model, a, b, *bodies):
            found.setdefault((a, b), _friction(model, a, b))
    return {(a, b): friction for (a, b), friction in found.items()}


def _meet(model: Any, a: int, b: int, body_a: int, body_b: int) -> bool:
    """Whether a file lets two geoms touch: by their bits, and unless they are parent and child."""
    welds = int(model.body_weldid[body_a]), int(model.body_weldid[body_b])
    above = [int(model.body_weldid[model.body_parentid[weld]]) for weld in welds]
    kin = 0 not in welds and (welds[0] == above[1] or welds[1] == above[0])
    if welds[0] == welds[1] or (kin and not model.opt.disableflags & _PARENTS_MEET):
        return False
    types, affinities = model.geom_contype, model.geom_conaffinity
    return bool(types[a] & affinities[b] or types[b] & affinities[a])


def _friction(model: Any, a: int, b: int) -> float:
    ranks = model.geom_priority[[a, b]]
    one = [a, b] if ranks[0] == ranks[1] else [a if ranks[0] > ranks[1] else b]
    return float(model.geom_friction[one][:, 0].max()) if model.geom_condim[one].max() > 1 else 0.0
