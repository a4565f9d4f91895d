"""A list of jobs and the one function that does each of them."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from typing import Any

Tell = Callable[[Any], None]
"""What a job calls with plain data on its way: numbers, texts, lists and dictionaries of them."""
Function = Callable[[Any, Tell], Any]
"""Does one job, ``function(job, tell)``; a public function of a module, found there by workers."""
Heard = Callable[[int, Any], None]
"""Called here with the place of a job in the list and what it told."""
TRIES = 3
"""How often a job is begun whose worker dies of it."""


@dataclass(frozen=True)
class Failure:
    """A job that raised ``error`` instead of giving a result."""

    error: Exception


def attempt(function: Function, job: Any, tell: Tell) -> Any:
    """Do a job: its result, or a :class:`Failure`."""
    try:
        return function(job, tell)
    except Exception as error:
        return Failure(error)


def in_turn(
    function: Function, jobs: Sequence[Any], heard: Heard
) -> Generator[tuple[int, Any], None, None]:
    """Do the jobs in this process one after another; yield place and outcome of each."""
    for place, job in enumerate(jobs):

        def tell(message: Any, place: int = place) -> None:
            heard(place, message)

        yield place, attempt(function, job, tell)


def died(place: int) -> Failure:
    """Say that a job is given up, for its worker died each time."""
    return Failure(
        RuntimeError(
            f"job {place + 1} is given up: its worker died each time, killed or out of"
            " memory; run fewer side by side"
        )
    )
