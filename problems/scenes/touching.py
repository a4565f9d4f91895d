"""Where the things of a scene may touch each other."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from itertools import combinations

from dynamics.systems.contacts import Contact, Disc, Pose, Shape
from problems.scenes.things import Body, Obstacle, Pusher, Thing

PoseOf = Callable[[Thing], Pose]
_FIRST = (Body, Pusher, Obstacle)


@dataclass(frozen=True, eq=False)
class Touch:
    """A contact called ``name``: ``shape`` of one thing on a shape of another.

    Its normal points into the ``one``, which is the one that moves more freely.
    """

    name: str
    one: Thing
    shape: Shape
    other: Thing
    against: Shape

    def contact(self, pose: PoseOf) -> Contact:
        """Gap, normal and point with every thing where ``pose`` has it."""
        return Contact.between(self.shape, pose(self.one), self.against, pose(self.other))

    @property
    def pair(self) -> frozenset[str]:
        """Names of both."""
        return frozenset((self.one.name, self.other.name))


def touches(things: Sequence[Thing], apart: Collection[frozenset[str]]) -> list[Touch]:
    """All contacts of two things of which one moves, but of the pairs in ``apart``.

    Where flat sides may come to lie on each other at any angle, every corner is a contact of its
    own, ``<one> on <other> <number>``: what rests on a side rests on its two ends, and the nearest
    corner alone would have no gradient where two are equally near.
    """
    found = []
    for first, second in combinations(things, 2):
        still = isinstance(first, Obstacle) and isinstance(second, Obstacle)
        if still or frozenset((first.name, second.name)) in apart:
            continue
        called = f"{first.name} on {second.name}"
        one, other = sorted((first, second), key=_rank)
        pairs = _shapes(one, other)
        names = [called] if len(pairs) == 1 else [f"{called} {i + 1}" for i in range(len(pairs))]
        found += [
            Touch(name, one, shape, other, against)
            for name, (shape, against) in zip(names, pairs, strict=True)
        ]
    return found


def _rank(thing: Thing) -> int:
    return next(i for i, kind in enumerate(_FIRST) if isinstance(thing, kind))


def _shapes(one: Thing, other: Thing) -> list[tuple[Shape, Shape]]:
    a, b = one.shape, other.shape
    round_one = any(len(shape.corners) == 1 for shape in (a, b))
    if round_one or not (one.turns or other.turns):
        return [(a, b)]
    return [*((disc, b) for disc in _corners(a)), *((a, disc) for disc in _corners(b))]


def _corners(shape: Shape) -> list[Disc]:
    return [Disc(shape.radius, corner) for corner in shape.corners]
