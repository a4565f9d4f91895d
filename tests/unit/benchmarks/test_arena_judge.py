"""The arena's judge and performance profile, on answers that are known."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from problems import get
from problems.registry import arena_names
from tests.benchmarks.arena.__main__ import keys_of, stored_answers
from tests.benchmarks.arena.judge import judged
from tests.benchmarks.arena.peers import Answer, penalised
from tests.benchmarks.arena.pool import rows_of
from tests.benchmarks.arena.race import solve_default
from tests.benchmarks.arena.report import profile, short_rows, summary


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


def test_short_rows_have_certified_answers_and_medians_of_the_drawn_families() -> None:
    answers = [
        {"task": "acrobot-stops", "way": way, "solved": k > 1, "feasible": k > 0, "cost": cost * k, "seconds": 1.0 + k}
        for way, cost in (("default", 1.0), ("quick", 2.0), ("published", 3.0))
        for k in range(4)
    ]
    row = next(row for row in short_rows(answers) if "acrobot" in row)
    assert row == "| acrobot-stops | 2 · 2 · 2.5 s | 2 · 4 · 2.5 s | 2 · 6 · 2.5 s |"


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


def test_all_instances_of_the_three_drawn_families_are_asked_for_once_each_way() -> None:
    keys = keys_of(arena_names(), 100, ["default", "published"])
    assert len(keys) == len(set(keys)) == 2 * (300 + len(arena_names()) - 3)
    assert keys[0][1] == 0 and {instance for task, instance, _ in keys if task == "acrobot-stops"} == {*range(1, 101)}


def test_stored_answers_of_another_commit_or_computer_are_measured_again(tmp_path: Path) -> None:
    row = {"task": "waiter", "instance": 0, "way": "quick"}
    file, now = tmp_path / "answers.json", {"commit": "a", "machine": "b"}
    assert stored_answers(file, now) == {}
    file.write_text(json.dumps({**now, "answers": [row]}))
    assert stored_answers(file, now) == {("waiter", 0, "quick"): row}
    assert stored_answers(file, {**now, "commit": "c"}) == stored_answers(file, {**now, "machine": "c"}) == {}


@pytest.mark.costly
def test_a_payload_on_a_cart_costs_what_a_plain_script_finds_and_a_hopper_in_stance_and_flight_is_certified() -> None:
    problem = get("transport")
    plain = judged(problem, penalised(problem))
    quick = judged(problem, solve_default(problem, "quick"))
    assert plain.solved and quick.solved and quick.cost <= plain.cost * (1 + 1e-5)
    hopper = get("stance-hopper")
    verdict = judged(hopper, solve_default(hopper, "quick"))
    assert verdict.solved and verdict.cost < 7


@pytest.mark.costly
def test_an_answer_over_its_processor_time_has_a_row_and_one_at_the_deadline_has_none() -> None:
    (row,) = rows_of([("push-recovery", 0, "published")], jobs=2, limit=3, wall=300)
    assert row["stationarity"] == "no answer" and not row["solved"] and row["seconds"] == 3
    assert list(rows_of([("push-recovery", 0, "published")], jobs=1, limit=100, wall=0)) == []
