"""The numbers of a judgement agree with those of a library, and its sentence agrees with the numbers."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from dynamics.systems import Signal
from ocp.learning.training import PolicyEvaluation
from reports.tables.training import evaluation_sentence, evaluation_summary

TASK = SimpleNamespace(horizon=10, measures=[SimpleNamespace(signal=Signal("speed", "m/s"))])


def judged(lengths: list[int], unsolved: list[list[int]]) -> PolicyEvaluation:
    n = len(lengths)
    returns = np.arange(n, dtype=float) ** 2
    lost = np.array(unsolved, dtype=int).reshape(-1, 2)
    nothing = np.zeros((n, 0, 0))
    return PolicyEvaluation(returns, np.array(lengths), {"speed": returns / 2}, nothing, nothing, lost)


def told(lengths: list[int], unsolved: list[list[int]]) -> dict:
    found = evaluation_summary(TASK, judged(lengths, unsolved))  # pyright: ignore[reportArgumentType]
    return {**found, "contact": "exact", "own": {"return": 3.0}}


def test_intervals_are_students() -> None:
    found = told([10, 10, 10, 10], [])
    values = np.array([0.0, 1, 4, 9])
    low, high = stats.t.interval(0.95, 3, values.mean(), stats.sem(values))
    assert found["return"]["interval"] == pytest.approx([low, high])
    assert found["measures"]["speed"]["interval"] == pytest.approx([low / 2, high / 2])
    assert found["measures"]["speed"]["unit"] == "m/s"
    assert (found["return"]["least"], found["return"]["most"]) == (0.0, 9.0)
    assert evaluation_sentence(found).startswith("Return 3.5 [")
    assert "over 4 episodes; in training it was 3." in evaluation_sentence(found)
    assert told([10], [])["return"]["interval"] is None


def test_a_fall_is_not_a_contact_that_found_no_solution() -> None:
    found = told([10, 4, 6, 10], [[2, 6]])
    assert (found["fallen"], found["lost"]) == (0.25, 0.25)
    assert found["unsolved"] == pytest.approx(1 / 30)
    assert "25 % of episodes end early" in evaluation_sentence(found)
    assert "contacts were not solved at 3.33 % of steps, where 25 % of episodes end" in evaluation_sentence(found)
