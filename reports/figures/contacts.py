"""Forces at contacts over time, against what friction can hold."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from reports.figures.run import time_panels
from reports.style import BLUE, INK, ORANGE, PURPLE, SKY, VERMILLION
from reports.view import RunView

_MOST_PANELS = 12
_NORMAL: dict[str, Any] = {"color": BLUE, "linewidth": 1.2}
_FRICTION: dict[str, Any] = {"color": VERMILLION, "linewidth": 1.2}
_CONE: dict[str, Any] = {"facecolor": PURPLE, "alpha": 0.3, "linewidth": 0}
_SLIP: dict[str, Any] = {"facecolor": ORANGE, "alpha": 0.25, "linewidth": 0}
_STICK: dict[str, Any] = {"facecolor": SKY, "alpha": 0.2, "linewidth": 0}
_WEAK: dict[str, Any] = {"color": INK, "marker": "v", "markersize": 3.5, "linestyle": ""}


def friction_forces(view: RunView) -> Figure | None:
    """Normal and friction force [N] of every contact that acts, in scenario 0 of the plan.

    Forces are impulses of a step over its length. The band is what friction can hold, +-friction
    times the normal force; steps at which the contact slips or sticks are shaded, and steps at
    which its complementarity is not strict marked. None for a run without friction or contact.
    """
    if view.array("friction_bound") is None:
        return None
    flags = {name: _first(view, name) > 0.5 for name in ("acts", "slides", "weak")}
    acting = np.flatnonzero(flags["acts"].any(axis=0))[:_MOST_PANELS]
    if not acting.size:
        return None
    h = np.diff(view.time)[:, None]
    normal, friction, bound = (
        _first(view, name) / h for name in ("normal_impulse", "friction_impulse", "friction_bound")
    )
    figure, axes = time_panels(len(acting))
    figure.set_figheight(1.5 * figure.get_figheight())
    names = [str(name) for name in view.run.data["point"].values]
    for axis, i in zip(axes, acting, strict=True):
        slides, acts = flags["slides"][:, i], flags["acts"][:, i]
        _shade(axis, view.time, slides, _SLIP)
        _shade(axis, view.time, acts & ~slides, _STICK)
        most = np.append(bound[:, i], bound[-1, i])
        axis.fill_between(view.time, -most, most, step="post", **_CONE)
        axis.stairs(normal[:, i], view.time, baseline=None, **_NORMAL)
        axis.stairs(friction[:, i], view.time, baseline=None, **_FRICTION)
        middle = (view.time[:-1] + view.time[1:]) / 2
        weak = middle[flags["weak"][:, i]]
        axis.plot(weak, np.zeros_like(weak), **_WEAK)
        axis.set_ylabel(f"{names[i]} [N]")
    figure.legend(handles=_handles(), loc="outside upper center", ncols=6)
    return figure


def _first(view: RunView, name: str) -> np.ndarray:
    """The first scenario's values of a stored array, (N, points)."""
    values = view.array(name)
    assert values is not None
    return values[0]


def _shade(axis: Axes, time: np.ndarray, when: np.ndarray, look: dict[str, Any]) -> None:
    # Neighbouring steps are one patch: between two of them a seam would show.
    edges = np.flatnonzero(np.diff(np.concatenate([[0], when.astype(int), [0]])))
    for first, end in zip(edges[::2], edges[1::2], strict=True):
        axis.axvspan(float(time[first]), float(time[end]), **look)


def _handles() -> list[Line2D | Patch]:
    return [
        Line2D([], [], label="normal", **_NORMAL),
        Line2D([], [], label="friction", **_FRICTION),
        Patch(label="$\\pm$friction normal", **_CONE),
        Patch(label="slips", **_SLIP),
        Patch(label="sticks", **_STICK),
        Line2D([], [], label="weak", **_WEAK),
    ]
