"""What a route leaves, and how two outcomes are combined."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ocp.programs.solver import Result
from ocp.routes.homotopy import Trace

GAIN = 1e-7
"""Relative fall of the cost for which an answer is exchanged for another."""


@dataclass(frozen=True)
class Outcome:
    """What one solve left: the result and its NLP, the table, and whether the path was finished.

    ``nlp`` is the :class:`~ocp.programs.program.Program` in whose variables the result is.
    ``on_branch`` is the same plan in the complementarity problem's variables, where the route came
    from there.
    """

    result: Result
    nlp: Any
    finished: bool
    trace: Trace
    on_branch: Result | None = None


def lower(one: Result, other: Result, by: float = GAIN) -> bool:
    """Whether one cost is lower than the other by more than a share of it."""
    return one.f < other.f - by * abs(other.f)


def better(one: Outcome | None, other: Outcome) -> Outcome:
    """Combine two outcomes of one problem.

    | one | other | taken |
    |---|---|---|
    | none | any | other |
    | finished | not | one |
    | not | finished | other |
    | both | both, or neither | other where its cost is lower, else one |
    """
    if one is None or (other.finished and not one.finished):
        return other
    if one.finished and not other.finished:
        return one
    return other if lower(other.result, one.result) else one
