"""The arena's judge and performance profile, on answers that are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from problems import get
from tests.benchmarks.arena.judge import judged
from tests.benchmarks.arena.peers import Answer, penalised
from tests.benchmarks.arena.race import solve_default
from tests.benchmarks.arena.report import profile, summary


def entry(task: str, way: str, seconds: float, solved: bool) -> dict:
    return {"task": task, "instance": 0, "way": way, "seconds": seconds, "solved": solved}


def test_profile_has_ratios_to_the_fastest_certified_answer() -> None:
    answers = [
        entry("a", "default", 4.0, True),
        entry("a", "published", 1.0, True),
        entry("b", "default", 3.0, True),
        entry("b", "published", 1.0, False),
        entry("c", "default", 2.0, False),
        entry("c", "published", 5.0, False),
    ]
    ratios = profile(answers)
    assert ratios["default"].tolist() == [1, 4, np.inf]
    assert ratios["published"].tolist() == [1, np.inf, np.inf]
    assert summary([1.0, 2.0, 3.0, 4.0, 5.0]) == ("3", "2 to 4") and summary([]) == ("–", "–")


def hanging(pairs: float = 0.0) -> tuple:
    """Return discs at rest at their goals without a force, and an impulse at a distance of size ``pairs``."""
    problem = get("discs-around", N=3, x1=-1, y1=1, x2=0, y2=0)
    x = np.tile(problem.initial_states(problem.parameters.values)[0], (4, 1))
    return problem, Answer(x, np.zeros((3, 2)), np.full((3, 1), pairs), 0.0, True, 0, 0.0)


def test_rest_at_the_goal_is_certified_and_costs_nothing() -> None:
    verdict = judged(*hanging())
    assert verdict.solved and verdict.cost == 0 and verdict.residual == 0 and verdict.stationarity == "B"


def test_a_force_at_a_distance_and_a_step_off_the_dynamics_are_found() -> None:
    problem, answer = hanging(1e-3)
    gap = np.sqrt(2) - 0.5
    verdict = judged(problem, answer)
    assert not verdict.feasible and verdict.product == pytest.approx(1e-3 * gap)
    # An impulse of 1 mN s changes the speed of 1 kg by 1 mm/s.
    assert verdict.residual == pytest.approx(1e-3 / np.sqrt(2))
    moved = replace(hanging()[1], x=hanging()[1].x + 1e-3 * np.eye(4, 8))
    assert judged(problem, moved).residual >= 1e-3


@pytest.mark.costly
def test_a_plain_script_and_the_default_solve_the_same_problem() -> None:
    problem = get("discs-around", N=6)
    default, plain = solve_default(problem), penalised(problem)
    verdicts = judged(problem, default), judged(problem, plain)
    assert all(verdict.solved for verdict in verdicts)
    assert verdicts[0].cost == pytest.approx(default.cost, rel=1e-9)
    assert verdicts[1].cost == pytest.approx(verdicts[0].cost, rel=1e-3)
