"""The machine that a system was built from, for simulators of the same machine."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

from dynamics.systems.planar.links import Branch, root_first

WORLD = "world"
"""The link or body of parts that never move, of machines in the plane and in space."""


@dataclass(frozen=True, eq=False)
class Mechanism:
    """The ``machine`` that a system steps, in the plane or in space.

    One unit of input is ``scale`` times a joint's gear; ``spheres`` may touch the ground, by
    default all. ``gyroscopic`` says how the step takes velocity forces in the plane.
    """

    machine: Any
    scale: float = 1.0
    spheres: tuple[str, ...] | None = None
    gyroscopic: Literal["explicit", "implicit"] = "explicit"


def check_parts(
    kind: str,
    members: Sequence[Branch],
    moving: Sequence[tuple[str, str]],
    parts: Sequence[tuple[str, str]],
    collision_pairs: Sequence[tuple[str, str]],
) -> None:
    """Raise ``ValueError`` for links or bodies that are no tree, and for wrong names on them.

    ``moving`` and ``parts`` are pairs (name, link or body); only the latter may be on the world.
    """
    names = [member.name for member in root_first(members)]
    if WORLD in names:
        raise ValueError(f"a {kind} is named {WORLD!r}, which never moves; give it another name")
    for name, owner in (*moving, *parts):
        if owner not in names and not (owner == WORLD and (name, owner) in parts):
            raise ValueError(f"{name!r} is on {kind} {owner!r}, which does not exist; choose from {', '.join(names)}")
    counts = Counter(name for name, _ in (*moving, *parts))
    if repeated := [name for name, count in counts.items() if count > 1]:
        raise ValueError(f"two parts are named {repeated[0]!r}; give each part its own name")
    owners = dict((*moving, *parts))
    for pair in collision_pairs:
        for name in pair:
            if name not in owners:
                raise ValueError(f"{name!r} is not a part; choose from {', '.join(owners)}")
        if len({owners[name] for name in pair}) == 1:
            raise ValueError(f"{' and '.join(pair)} are on the same {kind} and never meet")
