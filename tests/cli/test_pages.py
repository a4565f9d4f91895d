"""Pages of stored runs: contents of page 1, continuations with their motions, comparisons by differences."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ocp import store
from reports.documents.comparison import comparison_page, continuation_page
from reports.documents.solve import solve_page
from reports.drawing.style import house_style
from reports.drawing.view import RunView


@pytest.fixture(scope="module")
def views(store_of_runs: Path) -> dict[str, RunView]:
    found = [RunView.of(store.load(entry.path)) for entry in store.list_runs(store_of_runs)]
    return {f"{v.run.kind} {v.run.meta['problem']} {v.run.record['contact']}": v for v in found}


@pytest.fixture(autouse=True)
def styled_figures():
    with house_style():
        yield


@pytest.mark.costly
def test_page_one_names_law_method_and_policy(views) -> None:
    how = dict(solve_page(views["solve push-disc barrier"])[0]["request"])
    assert how == {
        "law": "barrier (μ = 0.001)",
        "method": "direct",
        "policy": "feedback",
        "solver": "ipopt",
        "steps": "20",
        "scenarios": "3",
    }
    how = dict(solve_page(views["solve push-1d exact"])[0]["request"])
    assert (how["law"], how["policy"]) == ("exact", "open-loop")


@pytest.mark.costly
def test_every_law_is_shown_over_time_and_a_smoothed_one_on_its_path(views) -> None:
    _, exact = solve_page(views["solve push-1d exact"])
    _, smoothed = solve_page(views["solve push-1d adaptive"])
    assert "contacts-01" in exact and "contact" not in exact
    assert "contacts-01" in smoothed and "contact" in smoothed


@pytest.mark.costly
def test_table_and_pictures_have_one_unit(views) -> None:
    view = views["solve push-1d exact"]
    content, drawn = solve_page(view)
    lam = view.array("lam")
    assert lam is not None
    peak = content["contact_heads"].index(">peak [N s]")
    assert float(content["contacts"][0][peak]) == pytest.approx(lam.max(), rel=1e-3)
    assert drawn["contacts-01"].axes[0].get_title("left").endswith("[N s]")
    assert "N s" in drawn["strobe"].axes[0].get_title("left")


@pytest.mark.costly
def test_a_comparison_tells_what_differs(views) -> None:
    runs = [views["solve push-1d exact"], views["solve push-1d adaptive"]]
    content, drawn = comparison_page(runs)
    assert content["labels"] == ["exact, direct", "adaptive, multiple-shooting"]
    assert content["grades"] == [view.run.meta["grade"] for view in runs]
    assert ["policy", "open-loop"] in content["request"]
    assert not [row for row in content["rows"] if row[0] in ("problem", "policy")]
    planned, exact, referee = drawn["costs"].axes[0].lines[:3]
    costs = np.array([view.run.meta["cost"] for view in runs])
    np.testing.assert_allclose(planned.get_xdata(), costs - costs.min())
    replays = [view.run.audit.exact_cost for view in runs]
    np.testing.assert_allclose(exact.get_xdata(), replays - costs.min())
    assert referee.get_label() == "under the referee"


def test_a_comparison_has_forces_and_differences(views) -> None:
    runs = [views["solve push-1d exact"], views["solve push-1d adaptive"]]
    _, drawn = comparison_page(runs)
    figures = [figure for name, figure in sorted(drawn.items()) if name.startswith("motion-")]
    axes = [axis for figure in figures for axis in figure.axes]
    above = {axis.get_title("left"): axis for axis in axes if axis.get_title("left")}
    states = runs[0].signals("states")
    assert list(above)[: len(states)] == [f"{s.name} [{s.unit}]" for s in states]
    assert sum(title.endswith("[N s]") for title in above) >= 1, "impulses are compared"
    first, second = (view.array("x") for view in runs)
    assert first is not None and second is not None
    strips = [axis for axis in axes if not axis.get_title("left")]
    drawn_ = np.asarray(strips[0].lines[-1].get_ydata())
    np.testing.assert_allclose(drawn_, (second - first)[0, :, 0])


def test_a_path_shows_its_motions(views) -> None:
    view = views["continue wall-1d barrier"]
    content, drawn = continuation_page(view)
    count = len(view.run.meta["points"])
    titles = [
        axis.get_title("left")
        for name, figure in sorted(drawn.items())
        if name.startswith("strobes-")
        for axis in figure.axes
        if axis.axison
    ]
    assert len(titles) == min(6, count)
    assert titles[0] == "μ = 0.1 N s m" and titles[-1] == "μ = 0.0001 N s m"
    panels = [
        axis.get_title("left")
        for name, figure in sorted(drawn.items())
        if name.startswith("motion-")
        for axis in figure.axes
        if axis.get_title("left")
    ]
    signals = [s for kind in ("states", "inputs", "contacts") for s in view.signals(kind)]
    assert panels == [f"{signal.name} [{signal.unit}]" for signal in signals]
    assert "contact.mu" not in content["verdict"]
    assert content["points"][0][4] in ("yes", "no")


@pytest.mark.costly
def test_the_swept_parameter_is_no_constant_and_is_that_of_each_point(views, monkeypatch) -> None:
    view = views["continue wall-1d barrier"]
    monkeypatch.setitem(view.run.meta, "over", "m")
    content, _ = continuation_page(view)
    names = [row[0] for row in content["parameters"]]
    assert "m" not in names and "h" in names
    values = view.run.data["value"].values
    assert view.at_point(2).params.m == values[2] != view.params.m


@pytest.mark.costly
def test_floors_are_not_drawn_as_data(views, monkeypatch) -> None:
    view = views["continue wall-1d barrier"]
    points = view.run.meta["points"]
    small = [{**point, "complementarity": 1e-15} for point in points]
    monkeypatch.setitem(view.run.meta, "points", [points[0], *small[1:]])
    content, drawn = continuation_page(view)
    _, middle, _ = drawn["path"].axes
    assert len(middle.lines[0].get_xdata()) == 1
    assert f"{len(points) - 1} of {len(points)} points" in content["floor"]
    monkeypatch.setitem(view.run.meta, "points", small)
    content, drawn = continuation_page(view)
    assert len(drawn["path"].axes) == 2 and "every point" in content["floor"]
