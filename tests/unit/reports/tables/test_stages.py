"""Shown stages are the accepted path and exchanges up to the solution."""

from __future__ import annotations

from ocp.routes.branches import NEIGHBOUR
from ocp.routes.homotopy import StageRecord
from reports.tables.console import StageLines, shown_stages, stage_note, stage_rows


def stage(label: str, cost: float, accepted: bool = True) -> StageRecord:
    return StageRecord(label, 0.0, cost, 0.0, 0.0, 1, 0.0, "said", accepted)


def test_neighbours_are_shown_where_they_lower_the_cost() -> None:
    stages = [
        stage("t", 1.0),
        stage("active set", 3.0),
        stage(NEIGHBOUR, 4.0),
        stage(NEIGHBOUR, 1.0, accepted=False),
        stage(NEIGHBOUR, 2.0),
        stage(NEIGHBOUR, 2.5),
    ]
    shown, found = shown_stages(stages, 2.0)
    assert found and [number for number, _ in shown] == [1, 2, 3], "numbers leave none out"
    assert [one.cost for _, one in shown] == [1.0, 3.0, 2.0]
    assert stage_note(stages, 2.0) == (
        "Stage 3 gave the answer. 3 neighbouring contact schedules were tried without a lower cost."
    )


def test_headings_are_printed_once_before_the_first_shown_stage(capsys) -> None:
    lines = StageLines()
    for one in (stage(NEIGHBOUR, 1.0, accepted=False), stage("active set", 2.0)):
        lines(one)
    printed = capsys.readouterr().err.splitlines()
    assert len(printed) == 2 and printed[0].split()[0] == "stage"


def test_the_table_ends_with_the_answer() -> None:
    lost = [stage("t", 0.9), stage("active set", 1.4), stage(NEIGHBOUR, 1.5)]
    stages = [stage("mu", 2.0), stage("mu", 1.0 + 1e-14), *lost]
    rows = stage_rows(stages, 1.0)
    assert [row[0] for row in rows] == ["1", "2"]
    assert [row[-1] for row in rows] == ["", "answer"]
    said = "Stage 2 gave the answer. 1 neighbouring contact schedule was tried without a lower cost."
    assert stage_note(stages, 1.0) == f"{said} 2 later stages were solved without a better answer."


def test_of_stages_with_the_same_cost_the_last_accepted_is_the_answer() -> None:
    stages = [stage("mu", 1.0), stage("mu", 1.0), stage("mu", 1.0, accepted=False)]
    shown, found = shown_stages(stages, 1.0)
    assert found and len(shown) == 2


def test_a_path_without_an_answer_is_shown_whole() -> None:
    stages = [stage("mu", 1.0), stage("mu", 2.0, accepted=False), stage("mu", 3.0)]
    for cost in (5.0, float("nan"), float("inf"), None):
        shown, found = shown_stages(stages, cost)
        assert not found and [one for _, one in shown] == stages
        assert stage_note(stages, cost) == "" and stage_rows(stages, cost)[-1][-1] == ""
    assert shown_stages([], 1.0) == ([], False)
