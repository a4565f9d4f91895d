"""Strobe pictures: arrows on drawn bodies, a picture for each scenario, one scale for all."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from matplotlib.patches import PathPatch, Polygon
from matplotlib.text import Annotation

from reports.drawing.strobe import picked_scenarios, strobe, strobe_rows
from tests.unit.reports.made import sliding_box

N = 40


def box(push: np.ndarray):
    normal = np.stack([push, np.zeros(N)], axis=-1)
    return sliding_box(normal, np.zeros_like(normal), x=np.linspace(0, 3, N + 1))


def arrows(axis) -> list[Annotation]:
    return [text for text in axis.texts if isinstance(text, Annotation)]


def places(axis) -> np.ndarray:
    """Return the middles of the drawn boxes along x."""
    found = [p for p in axis.patches if isinstance(p, Polygon | PathPatch)]
    boxes = [p.get_extents().transformed(axis.transData.inverted()) for p in found]
    return np.array([(b.x0 + b.x1) / 2 for b in boxes if b.width < 1])


def test_arrows_stand_on_bodies_that_are_drawn() -> None:
    figure = strobe(box(np.ones(N)))
    assert figure is not None
    (axis,) = figure.axes
    heels = places(axis) - 0.15
    tails = np.array([arrow.xyann[0] for arrow in arrows(axis)])
    assert 2 < len(tails) < N / 2, "none between the instants"
    assert np.abs(tails[:, None] - heels).min(axis=1) == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize("peak", [1, 7, 23, 39])
def test_the_instant_of_the_largest_force_is_drawn(peak: int) -> None:
    push = np.where(np.arange(N) == peak, 5.0, 0.0)
    figure = strobe(box(push))
    assert figure is not None
    (arrow,) = arrows(figure.axes[0])
    assert arrow.xyann[0] == pytest.approx(3 * (peak + 1) / N - 0.15)
    assert "5 N s" in figure.axes[0].get_title("left")


def test_pictures_beside_each_other_share_view_and_scale() -> None:
    small, large = box(np.ones(N)), box(np.full(N, 4.0))
    figures, told = strobe_rows([("A", small), ("B", large)])
    one, other = figures[0].axes
    assert (one.get_title("left"), other.get_title("left")) == ("A", "B")
    assert one.get_xlim() == other.get_xlim() and one.get_ylim() == other.get_ylim()
    lengths = [np.hypot(*np.subtract(a.xy, a.xyann)) for a in (arrows(one)[0], arrows(other)[0])]
    assert lengths[1] == pytest.approx(4 * lengths[0], rel=1e-9)
    assert told.endswith("the longest 4 N s")


@pytest.mark.costly_cases("6-2", "8-2", "12-3")
@pytest.mark.parametrize(("count", "rows"), [(1, 1), (3, 1), (4, 2), (6, 2), (8, 2), (12, 3)])
def test_every_run_has_its_picture(count: int, rows: int) -> None:
    shown = [(f"run {i}", box(np.ones(N))) for i in range(count)]
    figures, _ = strobe_rows(shown)
    assert len(figures) == rows
    titles = [axis.get_title("left") for figure in figures for axis in figure.axes if axis.axison]
    assert titles == [name for name, _ in shown]


def test_a_scenario_alone_is_that_scenario() -> None:
    view = box(np.ones(N))
    both = xr.concat([view.run.data, 2 * view.run.data], dim="scenario", data_vars="all")
    view = replace(view, run=view.run.with_data(both))
    x = view.scenario(1).array("x")
    assert view.scenarios == 2 and x is not None
    np.testing.assert_allclose(x[0, :, 0], np.linspace(0, 6, N + 1))


def test_of_many_scenarios_twelve_are_drawn_both_ends_among_them() -> None:
    assert picked_scenarios(5) == [0, 1, 2, 3, 4]
    picked = picked_scenarios(1000)
    assert len(set(picked)) == 12 and (picked[0], picked[-1]) == (0, 999)
