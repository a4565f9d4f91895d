"""Drawing of study N2."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from problems.registry import spec
from reports import shapes
from reports.camera import show
from reports.style import BLUE, GREEN, GREY, PURPLE, VERMILLION, WIDTH

caption = (
    "Top: start and goal, and the path of the object's middle, replayed under the exact law, for "
    "the plan of every contact law. Bottom: the object's part of the cost, at rest, of the plan, "
    "and of its replay."
)
_COLORS = (VERMILLION, BLUE, GREEN, PURPLE)
_MARKS = ("o", "s", "^", "D")


def draw(data: xr.Dataset) -> Figure:
    """One column a problem: the scene and the costs."""
    figure = Figure(figsize=(WIDTH, 5.4))
    names = [str(name) for name in data["problem"].values]
    scenes, bars = figure.subplots(2, len(names), height_ratios=(1.25, 1))
    for scene, axis, name in zip(scenes, bars, names, strict=True):
        at = data.sel(problem=name)
        _scene(scene, name, at)
        _costs(axis, at)
        scene.set_title(name)
    scenes[0].legend(loc="upper left")
    bars[0].set_ylabel("cost of the object")
    bars[0].legend(loc="upper center", ncols=3)
    return figure


def _scene(axis: Axes, name: str, data: xr.Dataset) -> None:
    found = spec(name)
    assert found.draw is not None
    problem, params = found.problem(), found.params({})
    start = problem.initial_states(problem.parameters.values)[0]
    drawn = found.draw(params, start)
    show(axis, drawn)
    for shape in drawn:
        shapes.draw(shape, axis, 1.0)
    for law, color, mark in zip(data["law"].values, _COLORS, _MARKS, strict=True):
        x, y, _ = data["path"].sel(law=law, motion="exact replay").values.T
        axis.plot(x, y, color=color, marker=mark, markersize=2.5, linewidth=0.8, label=str(law))
    axis.set(xlabel=found.axes[0], ylabel=found.axes[1])


def _costs(axis: Axes, data: xr.Dataset) -> None:
    places, kinds = np.arange(data.sizes["law"]), data["of"].values
    for offset, kind, color in zip((-0.27, 0, 0.27), kinds, (GREY, BLUE, VERMILLION), strict=True):
        values = data["cost"].sel(of=kind).values
        axis.bar(places + offset, values, 0.25, color=color, label=str(kind))
    axis.set_yscale("log")
    axis.set_ylim(1, 8 * float(data["cost"].max()))
    axis.set_xticks(places, [str(law) for law in data["law"].values])
