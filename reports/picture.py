"""What is drawn of a run: by the problem's own functions, or from what the run stores."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

import numpy as np

from ocp.errors import DamagedRun
from problems.drawing import (
    Box,
    Capsule,
    ContactFrame,
    Disc,
    HalfPlane,
    Mark,
    Segment,
    Shape,
    Spring,
)

if TYPE_CHECKING:
    from ocp.store.stored_run import StoredRun
    from reports.view import RunView

_KINDS: dict[str, type[Shape]] = {
    kind.__name__: kind for kind in (Disc, Box, Capsule, Segment, Spring, Mark, HalfPlane)
}
T = TypeVar("T", Shape, ContactFrame)


class Picture(Protocol):
    """Shapes and contacts of scenario 0 at any times [s], of the plan or with a suffix its replay.

    ``axes`` label the drawing, ``framed`` tells whether it is known where contacts act.
    """

    axes: tuple[str, str]
    framed: bool

    def shapes(self, suffix: str, times: np.ndarray) -> list[list[Shape]]:
        """Shapes at each time."""
        ...

    def contacts(self, suffix: str, times: np.ndarray) -> list[list[ContactFrame]]:
        """Contacts at each time, none where they are not known."""
        ...


def picture_of(view: RunView) -> Picture | None:
    """The picture of a run, None of one without states or drawing."""
    if view.array("x") is None:
        return None
    if view.spec is not None:
        return None if view.spec.draw is None else Drawn(view)
    told = view.run.own_problem
    return Kept(view.run, view.time, told) if told and told["motions"] else None


class Drawn:
    """By the functions of the problem."""

    def __init__(self, view: RunView) -> None:
        assert view.spec is not None
        self._view, self._spec = view, view.spec
        self.axes, self.framed = view.spec.axes, view.spec.frames is not None

    def shapes(self, suffix: str, times: np.ndarray) -> list[list[Shape]]:
        """Shapes at each time."""
        return self._at(self._spec.draw, suffix, times)

    def contacts(self, suffix: str, times: np.ndarray) -> list[list[ContactFrame]]:
        """Contacts at each time, none where they are not known."""
        return self._at(self._spec.frames, suffix, times)

    def _at(
        self, function: Callable[[Any, np.ndarray], list[T]] | None, suffix: str, times: np.ndarray
    ) -> list[list[T]]:
        x = self._view.array(f"x{suffix}")
        if function is None or x is None:
            return [[] for _ in times]
        states = np.stack([np.interp(times, self._view.time, each) for each in x[0].T], axis=1)
        return [function(self._view.params, state) for state in states]


@dataclass(frozen=True)
class _Kept:
    """Shapes and contacts at each node."""

    shapes: list[list[Shape]]
    contacts: list[list[ContactFrame]]


class Kept:
    """As the run stores it at its nodes; between two of them numbers go on in a straight line.

    Raises :class:`~ocp.errors.DamagedRun` for what is no drawing.
    """

    def __init__(self, run: StoredRun, nodes: np.ndarray, told: dict[str, Any]) -> None:
        self._nodes = nodes
        try:
            self._motions = {key: _read(motion) for key, motion in told["motions"].items()}
        except (KeyError, TypeError) as error:
            raise DamagedRun(f"{run.path} holds a drawing of no known shapes ({error})") from error
        self.axes = (told["axes"][0], told["axes"][1])
        self.framed = any(motion.contacts for motion in self._motions.values())

    def shapes(self, suffix: str, times: np.ndarray) -> list[list[Shape]]:
        """Shapes at each time."""
        return self._at(self._motions[suffix].shapes, times)

    def contacts(self, suffix: str, times: np.ndarray) -> list[list[ContactFrame]]:
        """Contacts at each time, none where they are not known."""
        kept = self._motions[suffix].contacts
        return self._at(kept, times) if kept else [[] for _ in times]

    def _at(self, kept: list[list[T]], times: np.ndarray) -> list[list[T]]:
        places = np.interp(times, self._nodes[: len(kept)], np.arange(len(kept)))
        return [_between(kept, float(place)) for place in places]


def _read(motion: dict[str, Any]) -> _Kept:
    return _Kept(
        [[_shape(**shape) for shape in at] for at in motion["shapes"]],
        [[ContactFrame(**contact) for contact in at] for at in motion["contacts"]],
    )


def _shape(kind: str, **values: Any) -> Shape:
    return _KINDS[kind](**values)


def _between(kept: list[list[T]], place: float) -> list[T]:
    """What is seen at a place between two nodes; the nearer of them where kinds change."""
    before, after = kept[int(place)], kept[min(int(place) + 1, len(kept) - 1)]
    if [type(one) for one in before] != [type(one) for one in after]:
        return kept[round(place)]
    share = place % 1.0
    return [_mixed(*pair, share) for pair in zip(before, after, strict=True)] if share else before


def _mixed(one: T, other: T, share: float) -> T:
    numbers = [f.name for f in fields(one) if isinstance(getattr(one, f.name), int | float)]
    return replace(
        one,
        **{key: (1 - share) * getattr(one, key) + share * getattr(other, key) for key in numbers},
    )
