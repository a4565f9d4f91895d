"""What a system was built from, for whoever simulates the same machine by other means."""

from dataclasses import dataclass
from typing import Any, Literal

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
