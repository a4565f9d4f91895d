"""The bare figure of a solve has every state, input and acting contact, planned and replayed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.text import Text

from dynamics.contact import Barrier
from ocp import solve, store
from ocp.errors import InputError
from ocp.store.stored_run import StoredRun
from problems import get
from reports.drawing.view import RunView
from reports.figures.paper import BOTH_COLUMNS_IN, bare_figure, group_signals, render_figure, solution_figure
from tests.unit.reports.made import sliding_box

NORMAL = np.array([[1.0, 0.0], [4.0, 0.01], [2.0, 0.0]])


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> StoredRun:
    solution = solve(get("push-1d", N=8), contact=Barrier(mu=1e-2))
    return store.load(store.save(solution, tmp_path_factory.mktemp("runs"), []).path)


def test_every_signal_is_in_the_panel_of_its_unit(run: StoredRun) -> None:
    view = RunView.of(run)
    found = group_signals(view)
    assert view.problem is not None
    system = view.problem.system
    assert [name for group in found[:-1] for name in group.names] == [
        signal.name
        for signals in (system.states, system.inputs)
        for unit in dict.fromkeys(signal.unit for signal in signals)
        for signal in signals
        if signal.unit == unit
    ]
    x = np.concatenate([group.planned for group in found if group.title.startswith("states")], -1)
    np.testing.assert_array_equal(np.sort(x), np.sort(run.data["x"].values))


def test_no_type_is_smaller_than_journals_set(run: StoredRun) -> None:
    figure = solution_figure(RunView.of(run))
    render_figure(figure, "pdf")
    sizes = [text.get_fontsize() for text in figure.findobj(Text) if text.get_text()]
    assert figure.get_figwidth() == BOTH_COLUMNS_IN and min(sizes) >= 7


def test_lines_are_the_stored_numbers_planned_and_replayed(run: StoredRun) -> None:
    figure = solution_figure(RunView.of(run))
    strobe, first, *_ = figure.axes
    assert strobe.get_xlabel() and first.get_xlabel() == "time [s]"
    planned, replayed = (
        [line for line in first.lines if (line.get_linestyle() == "-") is solid] for solid in (True, False)
    )
    names = [line.get_label() for line in planned]
    for lines, stored in ((planned, "x"), (replayed, "x_replay")):
        for line, name in zip(lines, names, strict=True):
            expected = run.data[stored].sel(state=name).values[0]
            np.testing.assert_array_equal(line.get_ydata(), expected)
            np.testing.assert_array_equal(line.get_xdata(), run.data["time"].values)
    (key,) = figure.legends
    assert [text.get_text() for text in key.get_texts()] == [
        "planned under the barrier law",
        "replayed under the exact law",
    ]


def test_contacts_that_hardly_push_are_left_out() -> None:
    """The toe's largest impulse is 1/400 of the heel's."""
    view = sliding_box(NORMAL, 0 * NORMAL)
    *_, pushed = group_signals(view)
    assert pushed.title == "impulses [N s]" and pushed.names == ["heel"]
    np.testing.assert_array_equal(pushed.planned, NORMAL[None, :, :1])
    assert pushed.replayed is not None
    np.testing.assert_array_equal(pushed.replayed, NORMAL[None, :, :1] / 2)


def test_a_run_that_is_no_solve_is_refused(run: StoredRun) -> None:
    study = replace(run, meta={**run.meta, "kind": "estimate"})
    with pytest.raises(InputError, match="is a run of ocp estimate, expected a run of ocp solve"):
        bare_figure(study, "pdf")
