"""Stages that are shown: the path, and exchanges that were taken."""

from __future__ import annotations

from ocp.routes.branches import NEIGHBOUR
from ocp.solution import StageRecord
from reports.console import hidden_stages, shown_stages


def stage(label: str, cost: float, accepted: bool = True) -> StageRecord:
    return StageRecord(label, 0.0, cost, 0.0, 0.0, 1, 0.0, "said", accepted)


def test_neighbours_are_shown_where_they_lower_the_cost() -> None:
    stages = [
        stage("t", 1.0), stage("active set", 3.0), stage(NEIGHBOUR, 4.0),
        stage(NEIGHBOUR, 1.0, accepted=False), stage(NEIGHBOUR, 2.0), stage(NEIGHBOUR, 2.5),
    ]  # fmt: skip
    assert [number for number, _ in shown_stages(stages)] == [1, 2, 5]
    assert hidden_stages(stages).startswith("3 neighbouring contact schedules")


def test_a_path_is_shown_whole() -> None:
    stages = [stage("mu", 1.0), stage("mu", 2.0, accepted=False), stage("mu", 3.0)]
    assert [one for _, one in shown_stages(stages)] == stages and hidden_stages(stages) == ""
