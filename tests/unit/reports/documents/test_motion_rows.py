"""Every state, input and multiplier has a panel, and the replay is drawn where it differs."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_hex

from ocp.errors import InputError
from reports.drawing.style import PLANNED, REPLAYED
from reports.figures import trajectories
from reports.figures.panels import PANEL_COLUMNS, Panel, draw_rows, lay_out_rows
from tests.unit.reports.documents.made import run, waves

N = 8


def titles(view) -> list[str]:
    return [cell.panel.title for row in trajectories.plan_rows(view) for cell in row]


def headings(view) -> list[str]:
    return [cell.heading for row in trajectories.plan_rows(view) for cell in row if cell.heading]


def large(**more):
    states = {**waves(3, "m", N + 1, "p"), **waves(13, "rad", N + 1, "q"), **waves(7, "rad/s", N + 1, "w")}
    return run(states, waves(9, "N m", N, "u"), waves(16, "N s", N, "c"), **more)


def test_all_components_are_shown_grouped_by_quantity() -> None:
    view = large()
    expected = [f"p{i} [m]" for i in range(3)] + [f"q{i} [rad]" for i in range(13)]
    expected += [f"w{i} [rad/s]" for i in range(7)] + [f"u{i} [N m]" for i in range(9)]
    expected += [f"c{i} [N s]" for i in range(16)]
    assert titles(view) == expected
    assert list(dict.fromkeys(headings(view))) == [
        "Positions [m]",
        "Angles [rad]",
        "Angular velocities [rad/s]",
        "Inputs [N m]",
        "Impulses λ [N s]",
    ]


@pytest.mark.parametrize("sizes", [(1,), (2, 5), (4, 1, 3), (2, 7, 6, 28), (3, 3, 3)])
def test_rows_hold_all_panels_in_order_and_waste_no_row(sizes: tuple[int, ...]) -> None:
    groups = {f"g{g}": [Panel(f"{g}.{i}", lambda _: None) for i in range(size)] for g, size in enumerate(sizes)}
    rows = lay_out_rows(groups)
    flat = [cell for row in rows for cell in row]
    assert [cell.panel for cell in flat] == [panel for group in groups.values() for panel in group]
    for row in rows:
        here = [cell.heading or None for cell in row]
        of = ["g" + cell.panel.title.partition(".")[0] for cell in row]
        first = [group if of.index(group) == i else None for i, group in enumerate(of)]
        assert here == first, "a group keeps its heading where it goes on"
    assert all([cell.column for cell in row] == list(range(len(row))) for row in rows)
    assert max(map(len, rows)) <= PANEL_COLUMNS
    assert len(rows) <= sum(-(-size // PANEL_COLUMNS) for size in sizes)


@pytest.mark.costly
def test_plan_and_replay_that_are_one_motion_have_no_differences() -> None:
    view = large()
    assert trajectories.replay_deviation(trajectories.tracks(view)) == 0
    assert not any(cell.panel.below for row in trajectories.plan_rows(view) for cell in row)
    figure = draw_rows(trajectories.plan_rows(view))
    colors = {to_hex(line.get_color()).upper() for axis in figure.axes for line in axis.lines}
    assert REPLAYED not in colors


def test_a_difference_is_replay_minus_plan_and_the_band_lies_between_them() -> None:
    states = {"a [m]": np.linspace(0, 1, N + 1)[None], "b [m]": np.ones((1, N + 1))}
    plan = np.stack(list(states.values()), axis=-1)
    way = np.linspace(0, 1, N + 1) ** 2
    off = np.stack([0.1 * way, 0.01 * way], axis=-1)[None]
    view = run(states, waves(1, "N", N, "u"), waves(1, "N s", N, "c"), replay={"x": plan + off})
    first = trajectories.plan_rows(view)[0]
    assert [cell.panel.below is not None for cell in first] == [True, True, False, False]
    figure = draw_rows([first])
    a = next(axis for axis in figure.axes if axis.get_title("left") == "a [m]")
    a_below, b_below = (axis for axis in figure.axes if not axis.get_title("left") and axis.get_xlabel())
    drawn = [line for line in a_below.lines if len(line.get_xdata()) > 2]
    np.testing.assert_allclose(drawn[0].get_ydata(), off[0, :, 0])
    assert a_below.get_ylim() == b_below.get_ylim() == pytest.approx((-0.11, 0.11)), "one scale"
    (band,) = (c for c in a.collections if isinstance(c, PolyCollection))
    heights = band.get_paths()[0].vertices[:, 1]
    assert heights.max() == pytest.approx(1.1) and heights.min() == pytest.approx(0)
    assert {to_hex(line.get_color()).upper() for line in a.lines} == {PLANNED, REPLAYED}


def test_a_replay_that_runs_away_does_not_flatten_the_plan() -> None:
    states = {"a [m]": np.linspace(0, 1, N + 1)[None]}
    away = 10.0 ** np.arange(N + 1)[None, :, None]
    view = run(states, waves(1, "N", N, "u"), waves(1, "N s", N, "c"), replay={"x": away})
    figure = draw_rows(trajectories.plan_rows(view))
    axis = next(axis for axis in figure.axes if axis.get_title("left") == "a [m]")
    low, high = axis.get_ylim()
    assert low <= 0 and 1 <= high < 5
    below = next(axis for axis in figure.axes if axis.get_ylim()[1] > 1e7)
    assert below.get_xlabel() == "time [s]", "the difference tells the whole way"


def test_multipliers_that_are_zero_throughout_are_named_instead() -> None:
    pushes = {"on [N s]": np.ones((1, N)), "off [N s]": np.full((1, N), 1e-12)}
    view = run({"a [m]": np.zeros((1, N + 1))}, waves(1, "N", N, "u"), pushes)
    assert trajectories.idle_multipliers(trajectories.tracks(view)) == ["off"]
    assert "on [N s]" in titles(view) and "off [N s]" not in titles(view)
    assert "a [m]" in titles(view), "a state that rests is shown"


def test_multipliers_that_contact_does_not_determine_are_told() -> None:
    pushes = {"a [N s]": np.ones((1, N)), "b [N s]": np.ones((1, N))}
    other = np.stack([np.full((1, N), 1.5), np.full((1, N), 0.5)], axis=-1)
    states, inputs = {"x [m]": np.linspace(0, 1, N + 1)[None]}, waves(1, "N", N, "u")
    same, differs = run(states, inputs, pushes), run(states, inputs, pushes, replay={"lam": other})
    assert not trajectories.multipliers_undetermined(trajectories.tracks(same))
    assert trajectories.multipliers_undetermined(trajectories.tracks(differs))
    rows = trajectories.plan_rows(differs)
    below = {cell.panel.title: cell.panel.below is not None for row in rows for cell in row}
    assert below == {"x [m]": False, "u0 [N]": False, "a [N s]": True, "b [N s]": True}


def test_every_scenario_has_its_line() -> None:
    states = {"a [m]": np.arange(3)[:, None] + np.linspace(0, 1, N + 1)}
    view = run(states, {"u [N]": np.ones((3, N))}, {"c [N s]": np.ones((3, N))})
    axis = draw_rows(trajectories.plan_rows(view)).axes[0]
    drawn = [np.asarray(line.get_ydata()) for line in axis.lines]
    np.testing.assert_allclose(drawn, states["a [m]"])


def test_kinds_of_pairs_are_groups_of_their_own() -> None:
    pushes = {f"{name} [N s]": np.ones((1, N)) for name in "abcd"}
    view = run(
        {"x [m]": np.zeros((1, N + 1))},
        waves(1, "N", N, "u"),
        pushes,
        kinds=["normal", "limit", "friction", "friction"],
    )
    assert headings(view)[2:] == ["Normal λ [N s]", "Limit λ [N s]", "Friction λ [N s]"]


@pytest.mark.parametrize(("share", "parts"), [(0.5e-4, False), (2e-4, True)])
@pytest.mark.parametrize("offset", [0.0, 10.0])
def test_a_replay_within_a_ten_thousandth_of_the_range_is_the_same_curve(
    share: float, parts: bool, offset: float
) -> None:
    """The comparison uses the signal's range, not its distance from zero."""
    plan = offset + np.linspace(0.0, 2.0, N + 1)[None]
    off = share * 2.0 * np.sin(np.linspace(0, np.pi, N + 1))
    track = trajectories.Track("Positions", "p", "m", plan, plan + off)
    assert track.span == pytest.approx(2.0, rel=1e-3)
    assert track.differs is parts
    level = trajectories.Track("Positions", "p", "m", np.ones((1, 3)), np.ones((1, 3)) * (1 + 1e-9))
    assert not level.differs, "rounding of a signal that does not move"


def test_signals_are_chosen_by_name_and_by_joker() -> None:
    view = large()
    names = trajectories.select_signals(view, "p1, w*,u0")
    assert names == ["p1", *(f"w{i}" for i in range(7)), "u0"]
    shown = [cell.panel.title for row in trajectories.plan_rows(view, (), names) for cell in row]
    assert shown == ["p1 [m]", *(f"w{i} [rad/s]" for i in range(7)), "u0 [N m]"]
    with pytest.raises(InputError, match=r"no signal 'pp1' \(did you mean 'p1'\?\); there are p0"):
        trajectories.select_signals(view, "u0,pp1")
