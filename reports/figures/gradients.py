"""Figure of secants over the amplitude, a panel for each simulator, with exact slopes and smoothed gradients."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ocp.store.stored_run import StoredRun
from reports.drawing.style import BLUE, FAINT, GREEN, GREY, INK, ORANGE, VERMILLION, WIDTH

COLUMNS = 2
"""Number of panels beside each other."""
PANEL_HEIGHT = 2.3
"""Largest height of a panel [inch]."""
PAGE_HEIGHT = 9.0
"""Largest height of all panels [inch]."""
MAX_TICKS = 7
"""Largest number of ticks of a symmetric logarithmic axis."""
_ESTIMATOR_STYLES = {"zobg-antithetic": ("s", GREEN, "zeroth order"), "fobg": ("^", ORANGE, "first order")}
"""Mapping from estimators to their marker, colour and text in the legend."""
_INTERVAL = 1.96
"""Half-width of intervals of 95 %, in standard errors."""


def gradients_figure(run: StoredRun) -> Figure:
    """Return a figure with a panel for each finished simulator: secants over the amplitude, on a symmetric scale."""
    rows = [row for row in run.meta["worlds"] if row["status"] == "done"]
    n_lines = -(-len(rows) // COLUMNS)
    figure = Figure(figsize=(WIDTH, min(PANEL_HEIGHT * n_lines, PAGE_HEIGHT) + 0.5))
    panels = np.ravel(figure.subplots(n_lines, min(COLUMNS, len(rows)), squeeze=False, sharex=True))
    for panel, row in zip(panels, rows, strict=False):
        _draw_world(panel, row)
    for panel in panels[len(rows) :]:
        panel.set_visible(False)
    parameter, output = run.meta["parameter"], run.meta["output"]
    for panel in panels[max(0, len(rows) - COLUMNS) : len(rows)]:
        panel.tick_params(labelbottom=True)
        panel.set_xlabel(f"amplitude, sigma [{parameter['unit']}]")
    unit = f"({output['unit']})/({parameter['unit']})"
    for panel in panels[::COLUMNS]:
        panel.set_ylabel(f"d{output['name']}/d{parameter['name']} [{unit}]")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4)
    return figure


def _draw_world(panel: Axes, row: Mapping[str, Any]) -> None:
    """Draw one simulator: secants with rounding errors, slopes at and near the nominal parameter, and references."""
    amplitudes, secants, errors = (_array(row[key]) for key in ("amplitudes", "secants", "errors"))
    nearby, truth = _array(row["nearby"]), row["truth"]
    has_exact_slope = row["truth_secants"] is not None
    panel.axhspan(np.nanmin(nearby), np.nanmax(nearby), color=FAINT, label="slopes nearby")
    panel.fill_between(amplitudes, secants - errors, secants + errors, color=BLUE, alpha=0.2, linewidth=0)
    panel.plot(amplitudes, secants, "o-", color=BLUE, label="secants")
    if row["slope"] is not None:
        panel.axhline(row["slope"], color=VERMILLION, linestyle="--", label="slope")
    if has_exact_slope:
        panel.plot(amplitudes, _array(row["truth_secants"]), color=GREY, linestyle=":", label="exact secants")
    panel.axhline(truth, color=INK, label="exact slope" if has_exact_slope else "widest secant")
    for name, (marker, color, legend_text) in _ESTIMATOR_STYLES.items():
        estimates = [
            estimate for estimate in row["smoothed"] if estimate["estimator"] == name and estimate["mean"] is not None
        ]
        if estimates:
            sigmas, means, deviations = (_array([e[k] for e in estimates]) for k in ("sigma", "mean", "standard_error"))
            panel.errorbar(
                sigmas, means, _INTERVAL * deviations, fmt=marker, color=color, linestyle="", label=legend_text
            )
    panel.set_xscale("log")
    _scale_slopes(panel, truth, [secants, nearby, _array([row["slope"]])])
    panel.set_title(f"{row['world']}: {row['verdict'].replace('-', ' ')}")


def _scale_slopes(panel: Axes, truth: float, values: Sequence[np.ndarray]) -> None:
    """Use a symmetric logarithmic axis if slopes are far larger than the exact slope ``truth``."""
    sizes = np.abs(np.concatenate(values))
    sizes = sizes[np.isfinite(sizes)]
    if sizes.size and truth and sizes.max() > 20 * abs(truth):
        exponent = np.ceil(np.log10(2 * abs(truth)))
        # The ticks next to zero need room beside those of many decades.
        linear_decades = max(1.0, (np.log10(sizes.max()) - exponent) / 4)
        panel.set_yscale("symlog", linthresh=10.0**exponent, linscale=linear_decades)
        panel.yaxis.get_major_locator().set_params(numticks=MAX_TICKS)  # pyright: ignore[reportCallIssue]
    panel.axhline(0, color=GREY, linewidth=0.5)


def _array(values: Sequence[float | None]) -> np.ndarray:
    return np.array([np.nan if value is None else value for value in values], dtype=float)
