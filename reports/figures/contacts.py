"""Impulses at contacts over time, against what friction can hold."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes

from reports.figures.panels import (
    Panel,
    Row,
    between,
    columns_for,
    in_rows,
    lines,
    note_zero,
    spans,
)
from reports.style import BLUE, INK, ORANGE, PURPLE, SKY, VERMILLION
from reports.view import RunView

_CONE: dict[str, Any] = {"facecolor": PURPLE, "alpha": 0.3}
_SLIP: dict[str, Any] = {"facecolor": ORANGE, "alpha": 0.25, "linewidth": 0}
_STICK: dict[str, Any] = {"facecolor": SKY, "alpha": 0.2, "linewidth": 0}
_DEGENERATE: dict[str, Any] = {"color": INK, "marker": "v", "markersize": 3.5, "linestyle": ""}


def friction_rows(view: RunView) -> tuple[list[Row], int]:
    """Normal and friction impulse [N s] of every contact that acts, in all scenarios of the plan.

    The band is what friction can hold, +-friction times the normal impulse; steps at which the
    contact slips or sticks are shaded, the paler the fewer scenarios do, and steps at which
    complementarity is not strict marked. Comes with the number of columns; there are no rows for a
    run without friction or contact.
    """
    if view.array("friction_bound") is None:
        return [], 1
    acting = np.flatnonzero((_all(view, "active") > 0.5).any(axis=(0, 1)))
    names = [str(name) for name in view.run.data["point"].values]
    panels = [_panel(view, names[i], int(i)) for i in acting]
    columns = columns_for(len(panels))
    return in_rows({"Contacts [N s]": panels}, columns), columns


def _panel(view: RunView, name: str, i: int) -> Panel:
    flags = ("active", "slipping", "degenerate")
    active, slips, degenerate = (_all(view, flag)[..., i] > 0.5 for flag in flags)
    normal, friction, bound = (
        _all(view, kind)[..., i]
        for kind in ("normal_impulse", "friction_impulse", "friction_bound")
    )
    width = {"linewidth": 1.2 if len(normal) == 1 else 0.5}

    def main(axis: Axes) -> None:
        share = 1 / len(normal)
        for slipping, touching, most in zip(slips, active, bound, strict=True):
            _shade(axis, view.time, slipping, _SLIP, share)
            _shade(axis, view.time, touching & ~slipping, _STICK, share)
            between(axis, view.time, -most, most, **{**_CONE, "alpha": _CONE["alpha"] * share})
        note_zero(axis)
        lines(axis, view.time, normal, color=BLUE, **width)
        lines(axis, view.time, friction, color=VERMILLION, **width)
        middle = (view.time[:-1] + view.time[1:]) / 2
        place = middle[degenerate.any(axis=0)]
        axis.plot(place, np.zeros_like(place), **_DEGENERATE)

    return Panel(f"{name} [N s]", main)


def _all(view: RunView, name: str) -> np.ndarray:
    """A stored array of all scenarios, (S, N, points)."""
    values = view.array(name)
    assert values is not None
    return values


def _shade(
    axis: Axes, time: np.ndarray, when: np.ndarray, look: dict[str, Any], share: float
) -> None:
    spans(axis, time, when, **{**look, "alpha": look["alpha"] * share})
