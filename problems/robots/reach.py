"""Which parts of a tree can never meet, whatever its joints do within their limits."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from dynamics.systems.space import (
    Body,
    Box,
    Capsule,
    Cylinder,
    Hull,
    Plane,
    Shape,
    SpatialPart,
    Sphere,
)

_MOST = 128
"""Pieces that the ranges of the joints above a part are cut into."""
_ROUND = 8
"""Balls that a capsule or a cylinder is covered with at most."""


class Balls(NamedTuple):
    """Balls with ``centres`` (n, 3) and ``radii`` (n,) [m]."""

    centres: np.ndarray
    radii: np.ndarray


class Reach:
    """Where the joints of a tree bring its parts.

    Each part is covered with balls, which the joints up to the nearest body that carries both of
    two parts move: the range of every joint is cut into pieces, and a ball that is moved by a piece
    lies in a larger one. Nothing is sampled.
    """

    def __init__(self, bodies: Iterable[Body]) -> None:
        self._bodies = {body.name: body for body in bodies}
        self._moved: dict[tuple[str, int], Balls] = {}

    def apart(self, one: SpatialPart, other: SpatialPart) -> bool:
        """Whether two parts can never meet; False where that is not known."""
        ways = [self._up(part.body) for part in (one, other)]
        while ways[0] and ways[1] and ways[0][-1] is ways[1][-1]:
            ways = [way[:-1] for way in ways]
        mine = self._balls(one, ways[0])
        if isinstance(other.shape, Plane):
            normal = np.array(other.shape.normal, float)
            heights = (mine.centres - np.array(other.shape.origin, float)) @ normal
            return bool((heights > mine.radii).all())
        theirs = self._balls(other, ways[1])
        gaps = cdist(mine.centres, theirs.centres) - mine.radii[:, None] - theirs.radii
        return bool((gaps > 0).all())

    def _up(self, name: str) -> list[Body]:
        """The bodies from one to its root."""
        body = self._bodies.get(name)
        return [] if body is None else [body, *self._up(body.parent or "")]

    def _balls(self, part: SpatialPart, way: list[Body]) -> Balls:
        key = part.name, len(way)
        if key not in self._moved:
            self._moved[key] = _moved(_balls(part.shape), way)
        return self._moved[key]


def _balls(shape: Shape) -> Balls:
    """Balls that cover a shape, which is no plane."""
    match shape:
        case Sphere():
            return Balls(np.array([shape.centre]), np.array([shape.radius]))
        case Capsule() | Cylinder():
            start, end = np.array(shape.start), np.array(shape.end)
            radius, length = float(shape.radius), float(np.linalg.norm(end - start))
            count = max(1, min(_ROUND, math.ceil(length / (2 * radius))))
            half = length / (2 * count)
            cover = half + radius if isinstance(shape, Capsule) else math.hypot(half, radius)
            shares = (np.arange(count)[:, None] + 0.5) / count
            return Balls(start + shares * (end - start), np.full(count, cover))
        case Box():
            half = np.array([shape.half_size], float)
            return Balls(np.array([shape.centre]), np.linalg.norm(half, axis=1))
        case Hull():
            points = np.array(shape.points)
            middle = (points.min(axis=0) + points.max(axis=0)) / 2
            return Balls(middle[None], np.array([np.linalg.norm(points - middle, axis=1).max()]))
    raise ValueError("a plane lies in no ball")


def _moved(balls: Balls, way: list[Body]) -> Balls:
    """Balls that hold all places of ``balls`` that the joints of ``way`` bring them to."""
    centres, radii = balls
    pieces = int(_MOST ** (1 / max(1, sum(body.joint in ("hinge", "slide") for body in way))))
    for body in way:
        if body.joint == "free" or (body.joint == "slide" and body.limits is None):
            return Balls(np.zeros((1, 3)), np.array([np.inf]))
        if body.joint == "ball":
            furthest = (radii + np.linalg.norm(centres, axis=1)).max()
            centres, radii = np.zeros((1, 3)), np.array([furthest])
        elif body.joint != "fixed":
            low, high = (float(end) for end in body.limits or (-math.pi, math.pi))
            if body.joint == "hinge" and high - low > 2 * math.pi:
                low, high = -math.pi, math.pi
            width, axis = (high - low) / pieces, np.array(body.axis, float)
            steps = (low + width * (np.arange(pieces)[:, None] + 0.5)) * axis
            if body.joint == "slide":
                wider, moved = width / 2, [centres + step for step in steps]
            else:
                # From its middle no point of an arc is further than the chord to its end.
                arms = np.linalg.norm(centres - np.outer(centres @ axis, axis), axis=1)
                wider = 2 * arms * math.sin(width / 4)
                moved = [turn.apply(centres) for turn in Rotation.from_rotvec(steps)]
            centres, radii = np.concatenate(moved), np.tile(radii + wider, pieces)
        turn = Rotation.from_quat(np.array(body.turn, float), scalar_first=True)
        centres = np.array(body.place, float) + turn.apply(centres)
    return Balls(centres, radii)
