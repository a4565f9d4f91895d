"""The counts of ``make bench-random``, and the distribution of its instances."""

from __future__ import annotations

import pytest

from problems import spec
from tests.benchmarks.ocp.random_draws import FACTOR, PROBLEMS, drawn
from tests.benchmarks.ocp.random_instances import (
    BASELINE,
    OTHERS,
    SHOOTING,
    Answer,
    best,
    is_worse,
    measured,
    summary,
)


@pytest.mark.parametrize("problem", PROBLEMS)
def test_draws_are_seeded_valid_and_near_the_defaults(problem: str) -> None:
    first, second = list(drawn(problem, 2, 0))
    assert first.params == next(drawn(problem, 1, 0)).params != second.params
    checked = spec(problem).params(first.params)
    for name, value in first.params.items():
        default = type(checked).model_fields[name].default
        assert abs(value - default) <= max((FACTOR - 1) * abs(default), 0.1)
    assert "N" not in first.params


def answers(own: float, other: float, status: str = "solved", certified: bool = True) -> dict:
    found = {name: Answer("infeasible", False, 0.0, 1.0, 1.0) for name in OTHERS}
    found[SHOOTING[0]] = Answer(status, certified, other, 1.0, 61.0)
    found["default"] = Answer("solved", True, own, 2.0, 0.5)
    return {**found, BASELINE: Answer("solved", True, own, 1.0, 0.5)}


def test_only_certified_answers_are_the_best_ones() -> None:
    assert best(answers(2.0, 1.0)) == 1.0 and is_worse(answers(2.0, 1.0))
    assert best(answers(2.0, 1.0, certified=False)) == 2.0
    assert not is_worse(answers(1.009, 1.0)) and is_worse(answers(1.011, 1.0))
    assert is_worse(answers(-1.0, -1.02)) and not is_worse(answers(-1.0, -1.005))


def test_floors_are_told_where_they_are_missed() -> None:
    found = summary([answers(2.0, 1.0), answers(1.0, 1.0, certified=False)])
    assert (found.solved, found.worse, found.shot, found.uncertified, found.slow) == (2, 1, 2, 1, 2)
    assert found.ratio == 2.0 and len(found.missed) == 4


def test_other_ways_are_kept_and_the_default_is_not() -> None:
    instance = next(drawn("wall-1d", 1, 0))
    stale = Answer("solved", True, 1.0, 1.0, 1.0)
    kept = {name: dict(vars(stale)) for name in [*OTHERS, "default"]}
    found = measured(instance, kept, {"default": lambda _: Answer("solved", True, 3.0, 1.0, 1.0)})
    assert found["default"].cost == 3.0 and found["scholtes"] == stale
