"""The page of a sweep shows the numbers of the study in the right places."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from matplotlib.collections import QuadMesh
from matplotlib.figure import Figure

from ocp.jobs.sweep_job import ROW_COUNTS, ROW_NUMBERS, ROW_TEXTS
from ocp.jobs.sweep_record import grid_rows, summarise_points
from ocp.labelled import LabelledArrays
from ocp.store.stored_run import StoredRun
from reports.documents.sweep import sweep_content
from reports.drawing.style import house_style
from reports.figures.sweep import replayed_ratio, sweep_figures
from reports.tables.listings import MAX_ROWS, format_duration, point_rows, sweep_line


def made(**sizes: int) -> StoredRun:
    """Return a stored sweep with the cost a + 10 b + 100 c at the indices a, b, c, and twice that in the replay."""
    names, shape = list(sizes), tuple(sizes.values())
    cost = 1 + sum(10.0**i * part for i, part in enumerate(np.indices(shape)))
    data: dict[str, object] = {name: (names, np.zeros(shape)) for name in (*ROW_NUMBERS, "seconds")}
    data |= {name: (names, np.ones(shape, dtype=int)) for name in ROW_COUNTS}
    data |= {name: (names, np.full(shape, "survives", dtype=object)) for name in ROW_TEXTS}
    data["outlier"] = (names, np.zeros(shape, dtype=int))
    data |= {"cost": (names, cost), "exact_cost": (names, 3 * cost)}
    data["referee_cost"] = (names, 2 * cost)
    values = {name: [float(k + 1) for k in range(size)] for name, size in sizes.items()}
    axes = [{"name": name, "values": values[name], "log": False, "units": "kg"} for name in names]
    meta = {
        "kind": "sweep",
        "study": {"axes": axes, "shape": list(shape), "failed": []},
        "points": cost.size,
        "solved": cost.size,
        "survives": cost.size,
        "success": True,
    }
    return StoredRun(Path("run"), LabelledArrays.of(xr.Dataset(data, coords=values)), meta)


def drawn(run: StoredRun) -> list[Figure]:
    with house_style():
        return sweep_figures(run.data, run.meta["study"]["axes"])


def maps(figure: Figure) -> list[np.ndarray]:
    meshes = [c for axes in figure.axes for c in axes.collections if isinstance(c, QuadMesh)]
    arrays = [mesh.get_array() for mesh in meshes]
    return [np.ma.filled(array, np.nan) for array in arrays if array is not None]


def test_lines_over_one_axis_are_the_costs_and_their_ratio() -> None:
    (figure,) = drawn(made(M=4))
    top, middle, _ = figure.axes
    cost = 1.0 + np.arange(4)
    assert [line.get_ydata().tolist() for line in top.lines[:3]] == [(k * cost).tolist() for k in (1, 3, 2)]
    assert middle.lines[1].get_ydata().tolist() == [2.0] * 4


def test_maps_over_two_axes_are_cost_ratio_and_verdict() -> None:
    run = made(mu=2, M=3)
    (figure,) = drawn(run)
    cost, ratio, verdict = maps(figure)[:3]
    # The longer axis is horizontal, although it is the study's second.
    assert np.array_equal(cost, run.data["cost"].transpose("mu", "M").values)
    assert np.array_equal(ratio, np.full((2, 3), 2.0)) and np.array_equal(verdict, np.full((2, 3), 2))
    assert figure.axes[0].get_xlabel() == "M [kg]" and "mu" in figure.axes[0].get_ylabel()


@pytest.mark.costly
def test_more_axes_are_gone_through_slice_by_slice() -> None:
    run = made(M=4, mu=3, h=2, w=3)
    found = drawn(run)
    assert [len(maps(figure)) for figure in found] == [3 * 4 + 2, 3 * 2 + 2]
    # M and mu, or M and w, span the maps; the other axes vary from map to map, the last one fastest.
    across, up, *rest = sorted(run.data["cost"].dims, key=lambda dim: -run.data.sizes[dim])
    expected = [
        run.data["cost"].isel({rest[0]: i, rest[1]: j}).transpose(up, across).values
        for i in range(run.data.sizes[rest[0]])
        for j in range(run.data.sizes[rest[1]])
    ]
    costs = [one for figure in found for one in maps(figure)[: len(maps(figure)) - 2][::3]]
    assert len(costs) == 6
    assert all(np.array_equal(one, other) for one, other in zip(costs, expected, strict=True))


@pytest.mark.costly
def test_failed_points_are_crossed_and_have_no_colour() -> None:
    run = made(M=3, mu=2)
    run.data["success"].values[1, 1] = 0
    run.data["grade"].values[1, 1] = "failed"
    (figure,) = drawn(run)
    cost, ratio, verdict = maps(figure)[:3]
    assert np.isnan(cost[1, 1]) and np.isnan(ratio[1, 1]) and verdict[1, 1] == 0
    crosses = figure.axes[0].lines[0]
    assert (crosses.get_xdata().tolist(), crosses.get_ydata().tolist()) == ([1], [1])


def test_points_that_a_neighbours_plan_would_improve_are_ringed_and_named() -> None:
    run = made(M=3, mu=2)
    run.data["outlier"].values[2, 1] = 1
    rings = [line for line in drawn(run)[0].axes[0].lines if line.get_marker() == "o"]
    assert [(line.get_xdata().tolist(), line.get_ydata().tolist()) for line in rings] == [([2], [1])]
    assert [row[-1] for row in point_rows(grid_rows(run.data), ["M", "mu"])] == ["survives"] * 5 + ["survives, outlier"]
    line = made(M=3)
    line.data["outlier"].values[1] = 1
    line.data["neighbour_cost"].values[1] = 1.5
    marks = {str(drawn_line.get_label()): drawn_line.get_ydata() for drawn_line in drawn(line)[0].axes[0].lines}
    assert np.array_equal(marks["outlier: a neighbour's plan"], [np.nan, 1.5, np.nan], equal_nan=True)


def test_without_a_referee_the_exact_law_replays() -> None:
    run = made(M=3)
    run.data["referee_cost"].values[:] = np.nan
    assert replayed_ratio(run.data).values.tolist() == [3.0] * 3


@pytest.mark.costly
def test_a_page_tells_all_points_up_to_a_number_and_counts_the_rest() -> None:
    content, found = sweep_content(made(M=3, mu=2))
    assert [*found] == content["maps"] == ["map-1"]
    assert content["key"][0] == ["points", "3 × 2"] and content["grade"] == "survives"
    assert content["points"][3][:3] == ["2", "2", "12"] and content["more"] == 0
    many, _ = sweep_content(made(M=MAX_ROWS + 5))
    assert len(many["points"]) == MAX_ROWS and many["more"] == 5


def test_what_is_left_is_told_as_people_say_it() -> None:
    assert [format_duration(s) for s in (0.4, 119, 600, 9000)] == ["0 s", "119 s", "10 min", "2.5 h"]
    row = {"success": 1, "cost": 1.25, "status": "solved"}
    assert sweep_line(3, 28, "M = 2", row, 40.0) == "3/28  M = 2  cost 1.25  40 s left"
    assert "refused" in sweep_line(3, 28, "M = 2", {**row, "success": 0, "status": "refused"}, 1.0)


@pytest.mark.parametrize("grade", ["survives", "failed"])
def test_rows_name_the_grade_or_how_a_point_failed(grade: str) -> None:
    run = made(M=2)
    run.data["grade"].values[:] = grade
    run.data["status"].values[:] = "infeasible"
    assert [row[-1] for row in point_rows(grid_rows(run.data), ["M"])] == [
        "infeasible" if grade == "failed" else "survives"
    ] * 2


def test_a_verdict_counts_and_names_the_ends() -> None:
    told = {"survives": 1, "success": 1, "verdict": "", "grade": "survives", "status": "solved"}
    found = [{**told, "M": 1.0, "cost": 2.0}, {**told, "M": 3.0, "cost": 1.0}]
    assert summarise_points(found, ["M"]) == (
        "All 2 points are solved, all survive the referee; cost from 1 at M = 3 to 2 at M = 1."
    )
    same = [{**one, "cost": 2.0, "survives": 0} for one in found]
    assert summarise_points(same, ["M"]) == ("All 2 points are solved, none survives the referee; cost 2.")
    failed = {**found[0], "success": 0, "survives": -1, "verdict": "Not solved: far.\nMore."}
    assert summarise_points([failed, found[1]], ["M"]) == (
        "1 of 2 points are solved, all survive the referee; cost 1.\nM = 1: Not solved: far."
    )
    many = [{**failed, "M": float(k)} for k in range(8)]
    assert summarise_points(many, ["M"]).splitlines()[0] == "0 of 8 points are solved."
    assert summarise_points(many, ["M"]).splitlines()[-1] == "and 3 more that failed"
