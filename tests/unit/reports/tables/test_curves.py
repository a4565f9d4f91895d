"""Curves drawn with characters in the terminal, live lines, and figures over seeds."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from matplotlib.figure import Figure
from rich.console import Console

from ocp.labelled import LabelledArrays
from ocp.store.stored_run import StoredRun
from reports.figures import training
from reports.tables.training import group_seeds, group_verdict, summary_rows, training_meta
from reports.tables.training_progress import (
    LearningCurve,
    bar_plot,
    progress_view,
    show_trainings,
    sparkline,
    training_line,
)


def run(seed: int, returns: list[float], *, told: bool = True, **asked: object) -> StoredRun:
    """Return a stored training run, evaluated at every second iteration; an iteration takes 1 s, or 2 s with seed 1."""
    iterations = len(returns)
    judged = np.where(np.arange(iterations) % 2 == 0, returns, np.nan)
    data = xr.Dataset(
        {
            "evaluation_return": ("iteration", judged),
            "evaluation_return_deviation": ("iteration", 0 * judged),
            "evaluation_length": ("iteration", 10 + 0 * judged),
            "evaluation_unsolved": ("iteration", 0 * judged),
            "evaluation_speed": ("iteration", judged / 10, {"units": "m/s"}),
            "env_steps": ("iteration", 100.0 * np.arange(iterations)),
            "wall_s": ("iteration", (1.0 + seed) * np.arange(iterations)),
            "best_iteration": int(np.nanargmax(judged)),
            **({"gradient_norm": ("iteration", np.arange(1.0, iterations + 1))} if told else {}),
        },
        coords={"iteration": np.arange(iterations)},
    )
    record = {
        "algorithm": "fopg",
        "contact": "adaptive",
        "iterations": iterations - 1,
        "algorithm_settings": {"rate": 0.1},
        **asked,
    }
    return StoredRun(Path(f"{seed}"), LabelledArrays.of(data), {"seed": seed, "record": record, **training_meta(data)})


def test_a_sparkline_spans_least_to_largest() -> None:
    assert sparkline([0, 1, 2, 3, 4, 5, 6, 7], 8) == "▁▂▃▄▅▆▇█"
    assert sparkline([7, float("nan"), 0], 8) == "█ ▁"
    assert sparkline(list(range(100)), 2) == "▁█"
    assert sparkline([3, 3], 8) == sparkline([-1, -1], 8)
    assert sparkline([float("nan")], 8) == " " and sparkline([], 8) == ""


def test_a_plot_is_as_high_as_its_values() -> None:
    rows = bar_plot([0.0, 1.0, 2.0], 10, 3)
    assert [row[0] for row in (rows[0], rows[-1])] == ["2", "0"]
    heights = [sum(row.ljust(9)[3 + k] != " " for row in rows) for k in range(3)]
    assert heights == [1, 2, 3]
    assert rows[0].endswith("█")


def test_a_training_under_way_in_one_line() -> None:
    rows = [{"iteration": k, "wall_s": 2.0 * k, "return_mean": float(k)} for k in range(5)]
    rows[2]["evaluation_return"] = 7.5
    one = LearningCurve("fopg seed 0", 20, rows)
    assert training_line(one) == "fopg seed 0  4/20  exact 7.5  return 4  8 s"
    assert one.left == pytest.approx(32.0)
    assert one.curve == [0, 1, 2, 3, 4]
    drawn = io.StringIO()
    Console(file=drawn, width=80).print(progress_view([one, LearningCurve("ars seed 0", 9)]))
    text = drawn.getvalue()
    assert "4/20" in text and "–/9" in text and "▁" in text


def test_what_is_heard_is_told_where_a_policy_was_judged(capsys: pytest.CaptureFixture) -> None:
    checks = []
    with show_trainings({"a": 3, "b": 3}, quiet=False, check=lambda: checks.append(1)) as heard:
        for k in range(4):
            judged = {"evaluation_return": 1.0 * k} if k % 3 == 0 else {}
            heard(1, {"iteration": k, "return_mean": 0.5, **judged})
    told = capsys.readouterr().err.splitlines()
    assert [row.split("  ")[:3] for row in told] == [["b", "0/3", "exact 0"], ["b", "3/3", "exact 3"]]
    assert len(checks) == 4
    with show_trainings({"a": 3}, quiet=True, check=lambda: None) as heard:
        heard(0, {"iteration": 0, "evaluation_return": 1.0})
    assert capsys.readouterr().err == ""


def test_seeds_of_one_way_are_a_group() -> None:
    runs = [
        run(0, [0.0, 1, 4]),
        run(1, [0.0, 1, 8]),
        run(0, [0.0, 1, 2], algorithm_settings={"rate": 0.2}),
        run(0, [0.0, 1, 3], algorithm="ars"),
    ]
    found = group_seeds(runs)
    assert [group.label for group in found] == ["fopg, rate = 0.1", "fopg, rate = 0.2", "ars"]
    assert [len(group.runs) for group in found] == [2, 1, 1]
    assert found[0].best is runs[1]
    told = group_verdict(found[0])
    assert "return under the exact law 6, from 4 to 8 over 2 seeds, speed 0.6" in told
    laws = group_seeds([runs[0], run(0, [0.0, 1, 2], contact="exact")])
    assert [group.label for group in laws] == ["fopg adaptive", "fopg exact"]


def test_who_cuts_gradients_says_so_in_verdict_and_table() -> None:
    settings = [{"clip": None}, {"clip": 1.0}, {"of": "fopg", "of.clip": None}]
    settings.append({"of": "fopg", "of.clip": 2.0})
    found = [group_seeds([run(0, [0.0, 1, 4], algorithm_settings=own)])[0] for own in settings]
    told = ["fopg", "fopg, gradients clipped", "fopg with psi", "fopg with psi, gradients clipped"]
    assert [group.label for group in found] == told
    assert group_verdict(found[1]).startswith("fopg, gradients clipped: return")
    assert summary_rows(found)[1][1][0] == "fopg, gradients clipped"


def test_the_best_policy_is_told_not_the_last() -> None:
    told = run(0, [1.0, 0, 5, 0, 3]).meta
    assert (told["return"], told["best_iteration"]) == (5.0, 2)
    assert (told["untrained"]["return"], told["last"]["return"]) == (1.0, 3.0)
    assert told["evaluation"]["speed"] == 0.5
    assert (told["env_steps"], told["wall_s"]) == (400.0, 4.0)


def test_bands_are_from_the_lowest_to_the_highest_seed() -> None:
    found = group_seeds([run(0, [0.0, 9, 4]), run(1, [2.0, 9, 8])])
    figure = training.learning_figure(found)
    over_steps, over_time = figure.axes[:2]
    band = over_steps.collections[0].get_paths()[0].vertices
    ends = {float(x): sorted({float(y) for a, y in band if a == x}) for x in (0.0, 200.0)}
    assert ends == {0.0: [0.0, 2.0], 200.0: [4.0, 8.0]}
    assert over_steps.lines[0].get_xydata().tolist() == [[0.0, 1.0], [200.0, 6.0]]
    # One seed took 1 s per iteration and the other 2 s.
    assert over_time.lines[0].get_xydata().tolist() == [[0.0, 1.0], [3.0, 6.0]]


def test_signals_are_of_those_that_tell_them() -> None:
    found = group_seeds([run(0, [0.0, 1, 4]), run(0, [0.0, 1, 4], algorithm="ars", told=False)])
    figure = training.signal_figure(found)
    assert isinstance(figure, Figure)
    assert [axis.get_title(loc="left") for axis in figure.axes] == ["norm of the gradient"]
    assert len(figure.axes[0].lines) == 1
    assert training.signal_figure(found[1:]) is None


@pytest.mark.costly
def test_learned_parameters_stand_beside_the_tasks_own() -> None:
    from problems.tasks import registry
    from reports.documents.pdf import render_pdf
    from reports.documents.training import training_content
    from reports.drawing.view import RunView

    task = registry.get("ball-throw")
    made = run(0, [0.0, 1, 4])
    values = task.parameters.values.copy()
    values[task.parameters.names.index("m")] = 1.25
    data = made.data.assign(psi=("physical", values), theta=("parameter", [0.1, 0.2]))
    data = data.assign_coords(physical=task.parameters.names)
    meta = {**made.meta, "problem": "ball-throw", "hash": "0"}
    stored = StoredRun(made.path, LabelledArrays.of(data), {**meta, "record": {**made.record, "params": {}}})
    content = training_content([RunView.of(stored)])[0]
    assert content["psi"] == [["fopg", "m", "1.25", "1", "kg"]]
    assert ["speed [m/s]", "0.4"] in content["key"]
    assert render_pdf([stored])[:5] == b"%PDF-"
