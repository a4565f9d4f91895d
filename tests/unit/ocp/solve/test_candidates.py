"""Candidates that raise an error do not affect the others; invalid starts, seeds and ranks are rejected."""

from __future__ import annotations

from typing import Any

import pytest

from ocp import solve
from ocp.errors import InputError
from ocp.solve import starts
from tests.findings import numbers

judge_outcome = starts.judge_outcome


def failing(monkeypatch: pytest.MonkeyPatch, *numbers: int) -> None:
    """Make the judgement of the candidates with these numbers raise an error."""
    calls: list[int] = []

    def judge(*given: Any) -> Any:
        calls.append(len(calls))
        if calls[-1] in numbers:
            raise RuntimeError("the judge fell ill")
        return judge_outcome(*given)

    monkeypatch.setattr(starts, "judge_outcome", judge)


@pytest.mark.costly
@pytest.mark.parametrize("number", [0, 1])
def test_one_candidate_that_raises_loses_nothing(monkeypatch: pytest.MonkeyPatch, number: int) -> None:
    expected = solve("wall-1d", contact="barrier").cost
    failing(monkeypatch, number)
    found = solve("wall-1d", contact="barrier", n_starts=3)
    assert found.success
    assert found.cost == pytest.approx(expected, rel=1e-6)
    assert len(found.route.attempts) == 2
    told = numbers(found, "attempts-failed")
    assert told["count"] == 1 and told["error"].startswith("RuntimeError: 'the judge fell ill'")


def test_what_all_candidates_raise_is_raised(monkeypatch: pytest.MonkeyPatch) -> None:
    failing(monkeypatch, 0, 1)
    with pytest.raises(RuntimeError, match="fell ill"):
        solve("wall-1d", contact="barrier", n_starts=2)


@pytest.mark.parametrize(
    ("given", "reason"),
    [
        ({"rank_by": "x"}, "unknown rank 'x'"),
        ({"seed": -1}, "seed must be"),
        ({"seed": 1.5}, "seed must be"),
        ({"n_starts": 2.5}, "n_starts must be"),
        ({"n_starts": 0}, "n_starts must be"),
    ],
)
def test_nonsense_is_refused_before_any_work(given: dict[str, Any], reason: str) -> None:
    with pytest.raises(InputError, match=reason):
        solve("wall-1d", **given)
