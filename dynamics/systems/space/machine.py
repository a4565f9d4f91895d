"""Machines in space: trees of bodies whose parts touch the world and each other."""

from __future__ import annotations

from dataclasses import dataclass, field

from dynamics.systems.space.body import Body, Vector
from dynamics.systems.space.shapes import Shape

WORLD = "world"


@dataclass(frozen=True, eq=False)
class SpatialPart:
    """A ``shape`` fixed to a body, in its frame, or to the :data:`WORLD`, where it never moves."""

    name: str
    body: str
    shape: Shape


@dataclass(frozen=True, eq=False)
class SpatialMachine:
    """A tree of bodies, the parts on them, and who meets whom.

    ``meetings`` are pairs of names of parts, on two bodies each, that may touch; one of them may be
    on the :data:`WORLD`. Their contacts are called ``<one> on <other>``, with a number behind where
    a pair has several points. ``gravity`` is an acceleration [m/s²].
    """

    bodies: tuple[Body, ...]
    parts: tuple[SpatialPart, ...] = ()
    meetings: tuple[tuple[str, str], ...] = ()
    gravity: Vector = field(default=(0.0, 0.0, -9.81), kw_only=True)
