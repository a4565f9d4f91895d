"""What a model of a step is."""

from __future__ import annotations

from typing import ClassVar, Protocol, runtime_checkable

from dynamics.contact.casadi_map import LearnedMap
from dynamics.learned.origin import Origin


@runtime_checkable
class StepModel(LearnedMap, Protocol):
    """A map from state and input to the next state that knows whose data it has learned from."""

    kind: ClassVar[str]

    @property
    def origin(self) -> Origin:
        """What its numbers are called, and which data it saw."""
        ...
