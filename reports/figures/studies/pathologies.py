"""Drawings of studies P1 to P7, on gradients through contact [pathologies]."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from matplotlib.patches import Arc, Rectangle
from matplotlib.ticker import NullFormatter

from reports.drawing.style import BLUE, CYCLE, GREEN, GREY, INK, PURPLE, VERMILLION, WIDTH
from reports.figures.studies.panels import break_at_jumps, drawing, gradient_panel, light_to_dark

_P1_COLUMNS = (
    ("drop", "A. dropped ball", "drop at $\\theta$ [m]", "minus height [m]", "[m/m]"),
    ("throw", "B. throw past a wall", "angle $\\theta$ [rad]", "minus distance$^2$ [m$^2$]", "[m$^2$/rad]"),
    ("pivot", "C. pivoted bar", "angle $\\theta$ [rad]", "$-\\omega^2$ [s$^{-2}$]", "[s$^{-2}$/rad]"),
)
"""Name, title and labels of each column in study P1."""


@drawing(
    "Top: the objective (black) and its smoothing over the decision. Bottom: the gradient of the "
    "smoothed objective by quadrature (grey), and the estimates from equally many samples."
)
def p1(data: xr.Dataset) -> Figure:
    """Draw study P1: objectives above gradients, one column per system."""
    figure = Figure(figsize=(WIDTH, 4.6))
    axes = figure.subplots(2, 3)
    for column, (name, title, decision, objective, unit) in enumerate(_P1_COLUMNS):
        top, bottom = axes[:, column]
        theta = data[f"theta_{name}"].values
        f = data[f"f_{name}"].values
        top.plot(data[f"fine_{name}"], break_at_jumps(f, 0.05 * np.ptp(f)), color=INK, label="$f$")
        top.plot(theta, data[f"F_{name}"], color=VERMILLION, label="$F$")
        estimates = (data[f"{order}_{name}"][:, 0] for order in ("first", "zeroth"))
        gradient_panel(bottom, theta, data[f"slope_{name}"], *estimates)
        top.set(title=title, ylabel=objective)
        bottom.set(xlabel=decision, ylabel=f"gradient {unit}")
    axes[0, 0].legend()
    axes[1, 1].legend(loc="lower right")
    return figure


_P2_MARKERS = {"zobg": "o", "zobg-zero-noise": "^", "zobg-mean": "s", "fobg": "x"}
"""Mapping from estimators to their markers in study P2."""


@drawing(
    "Heaviside objective and its smoothed form, gradient estimates and the empirical variance of "
    "one sample over the decision; lines: closed forms, marks: samples."
)
def p2(data: xr.Dataset) -> Figure:
    """Draw study P2: objective, gradient and variance over the decision theta."""
    figure = Figure(figsize=(WIDTH, 2.6))
    objective_axis, gradient_axis, variance_axis = figure.subplots(1, 3)
    theta = data["theta"].values
    objective_axis.step(theta, data["f"], where="mid", color=INK, label="f")
    objective_axis.plot(theta, data["F"], color=CYCLE[0], label="F")
    objective_axis.plot(theta, data["F_sampled"], ".", color=CYCLE[0], markersize=3)
    objective_axis.set_ylabel("objective")
    objective_axis.legend()
    gradient_axis.plot(theta, data["gradient"], color=INK)
    variance_axis.plot(theta, data["zobg_variance"], color=INK, label="closed form")
    for color, (name, mark) in zip(CYCLE, _P2_MARKERS.items(), strict=False):
        estimates = data.sel(estimator=name)
        if name in ("zobg", "fobg"):
            gradient_axis.plot(theta, estimates["mean"], mark, color=color)
        variance_axis.plot(theta, estimates["variance"], mark, color=color, label=name, markersize=3)
    gradient_axis.set_ylabel("gradient")
    variance_axis.set(ylabel="variance of one sample", ylim=(0, 1.5 * float(data["variance"].max())))
    variance_axis.legend(ncols=2, fontsize=7, columnspacing=0.8, handletextpad=0.2)
    for axis in (objective_axis, gradient_axis, variance_axis):
        axis.set_xlabel("$\\theta$")
    return figure


@drawing(
    "Relaxed friction over sliding velocity, and the impulse on a block behind it (dashed); "
    "estimates over sample count; empirical variance over slip tolerance (marks: 1000 samples, "
    "crosses: many, lines: closed forms), and that of the block."
)
def p3(data: xr.Dataset) -> Figure:
    """Draw study P3: relaxed friction, running estimates, and variances over the slip tolerance."""
    figure = Figure(figsize=(WIDTH, 4.8))
    (friction, running), (variance, block) = figure.subplots(2, 2)
    slip = data["slip"].values
    for color, nu in zip(CYCLE, data["width"].values, strict=False):
        width_data = data.sel(width=nu)
        friction.plot(slip, width_data["friction"], color=color, label=f"$\\nu$ = {nu:g} m/s")
        friction.plot(slip, width_data["block_impulse"], "--", color=color)
    friction.set(xlabel="sliding velocity [m/s]", ylabel="share of the limit")
    friction.legend()
    for color, name in zip(CYCLE, data["order"].values, strict=False):
        running.plot(data["n"], data["running_mean"].sel(order=name), color=color, label=str(name))
        variances = data["variance"].sel(order=name).values
        is_positive = variances > 0
        variance.loglog(data["nu"][is_positive], variances[is_positive], ".", color=color, label=str(name))
        variance.loglog(data["nu"], data[f"{name}_variance"], color=color)
        for axis, grid, mark, many in (
            (variance, "coarse", "x", "wide_variance"),
            (block, "block_nu", "x-", "block_variance"),
        ):
            values = data[many].sel(order=name).values
            axis.loglog(data[grid], np.where(values > 0, values, np.nan), mark, color=color)
    running.axhline(float(data["truth"]), color=INK, linewidth=0.8, linestyle="--")
    running.set(ylim=(-5, 4 * float(data["truth"])), xlabel="samples", ylabel="gradient [s/m]")
    running.legend()
    variance.set(ylabel="variance of one sample [s$^2$/m$^2$]", title="relaxed friction")
    block.set_title("block on a belt")
    for axis in (variance, block):
        axis.set_xlabel("slip tolerance $\\nu$ [m/s]")
    return figure


_P4_COLORS = (GREEN, PURPLE)
"""Colours of rectangle and dome in study P4."""


@drawing(
    "Top: throws past the corner of the rectangle (left) and of the dome (right). Middle: minus "
    "the distance over the angle (left); variance of one sample's gradient at the corner's angle "
    "as the dome shrinks (right). Bottom: gradient of the smoothed objective by quadrature (grey) "
    "and estimates, at the rectangle (left) and the dome (right)."
)
def p4(data: xr.Dataset) -> Figure:
    """Draw study P4: paths of throws, objective, variance and gradients."""
    figure = Figure(figsize=(WIDTH, 6.6))
    paths, (objective, variance), gradients = figure.subplots(3, 2)
    middle, width, height = (data.attrs[name] for name in ("place", "width", "height"))
    fine = data["fine"].values
    for index, (color, name) in enumerate(zip(_P4_COLORS, data["shape"].values, strict=True)):
        axis = paths[index]
        axis.add_patch(Rectangle((middle - width / 2, 0), width, height, color=GREY, alpha=0.4))
        if index:
            axis.add_patch(Arc((middle, height), width, width, theta1=0, theta2=180, color=INK))
        for path in data["path"].values[index]:
            axis.plot(path[:, 0], path[:, 1], color=color, linewidth=0.8)
        axis.set(xlim=(1.35, 1.6), ylim=(0.45, 0.55), xlabel="$x$ [m]", ylabel="$y$ [m]", title=str(name))
        f = break_at_jumps(data["f"].values[index], 0.05)
        objective.plot(fine, f, color=color, linewidth=2.6 - 1.6 * index, label=str(name))
        gradient, theta = gradients[index], data["theta"].values
        estimates = (data[order][index, :, 0] for order in ("first", "zeroth"))
        gradient_panel(gradient, theta, data["slope"][index], *estimates)
        gradient.set(xlabel="angle $\\theta$ [rad]", ylabel="gradient [m/rad]")
    wide = data["width"].values
    variance.loglog(wide, data["narrow_variance_first"], "o-", color=BLUE, label="FoBG")
    variance.loglog(wide, data["narrow_variance_zeroth"], "s-", color=VERMILLION, label="ZoBG")
    variance.set_xticks(wide[::2], [f"{value:.3g}" for value in wide[::2]])
    for scale in (variance.xaxis, variance.yaxis):
        scale.set_minor_formatter(NullFormatter())
    variance.set(xlabel="diameter of the dome [m]", ylabel="variance [m$^2$/rad$^2$]")
    objective.set(xlabel="angle $\\theta$ [rad]", ylabel="minus distance [m]")
    for axis in (objective, variance, gradients[0]):
        axis.legend()
    return figure


@drawing(
    "Variance of the gradient by all inputs over the stiffness of the spring; the vertical line is "
    "the analytic limit of semi-implicit integration. Horizontal: implicit time stepping, which "
    "has no stiffness, under the exact law (full) and softened (dotted)."
)
def p5(data: xr.Dataset) -> Figure:
    """Draw study P5: the variance of gradients over the stiffness k of the contact spring."""
    figure = Figure(figsize=(WIDTH, 3.6))
    axis = figure.subplots()
    k = data["k"].values
    axis.loglog(k, data["first_order"], "o-", color=BLUE, label="FoBG, spring")
    axis.loglog(k, data["zeroth_order"], "s-", color=VERMILLION, label="ZoBG, spring")
    implicit = data["implicit_first"].values
    axis.axhline(implicit[0], color=GREEN, label="FoBG, implicit time stepping")
    for value in implicit[1:]:
        axis.axhline(value, color=GREEN, linestyle=":", linewidth=1.0)
    limit = float(data["limit"])
    axis.axvline(limit, color=INK, linestyle="--", linewidth=0.9)
    axis.text(limit * 0.93, 1e12, "$m (1 + c)/h^2$", rotation=90, ha="right", va="center")
    finite = np.concatenate((data["first_order"].values, implicit))
    axis.set_ylim(np.nanmin(finite) / 3, 1e20)
    axis.set(xlabel="stiffness $k$ [N/m]", ylabel="variance [m$^4$/N$^2$]")
    axis.legend(loc="upper left")
    return figure


@drawing(
    "Next position and its slope over the input impulse at (x, v) = 0: the QP of eq. 3 (dashed) "
    "and the log barrier of eq. 4 (lines: contact law; dots: closed form of eq. 5)."
)
def p6(data: xr.Dataset) -> Figure:
    """Draw study P6: the next position and its derivative over the input impulse."""
    figure = Figure(figsize=(WIDTH, 3.0))
    position_axis, slope_axis = figure.subplots(1, 2)
    u, kappas = data["u"].values, data["kappa"].values
    shades = light_to_dark(len(kappas))
    for index, (kappa, shade) in enumerate(zip(kappas, shades, strict=True)):
        position_axis.plot(u, data["x_barrier"][index], color=shade, label=f"$\\kappa$ = {kappa:g} J$^{{-1}}$")
        position_axis.plot(u[::10], data["x_eq5"][index][::10], ".", color=shade, markersize=3)
        slope_axis.plot(u, data["slope_barrier"][index], color=shade)
    for axis, name in ((position_axis, "x_qp"), (slope_axis, "slope_exact")):
        axis.plot(u, data[name], "--", color=INK, linewidth=1.0, label="QP" if axis is position_axis else None)
        axis.set_xlabel("input impulse $u$ [N s]")
    position_axis.set_ylabel("next position $x^+$ [m]")
    slope_axis.set_ylabel("$\\partial x^+ / \\partial u$ [m/(N s)]")
    position_axis.legend()
    return figure


_P7_MARKERS = ("o", "x", "^", "s", "D")
"""Markers of the estimators in study P7."""
_P7_UNITS = {"heaviside": "", "coulomb": " [m/s]", "ball-wall": " [rad]"}
"""Mapping from each case in study P7 to the unit of its decision."""


@drawing(
    "Above: gradient estimates of one run over the decision (line: the gradient, band: the allowed "
    "error). Below: mean weight of the first order over all runs."
)
def p7(data: xr.Dataset) -> Figure:
    """Draw study P7: gradient estimates, and weights of the first order, of three cases."""
    figure = Figure(figsize=(WIDTH, 4.2))
    rows = figure.subplots(2, 3, sharex="col", height_ratios=(1.6, 1))
    for k, case in enumerate(map(str, data["case"].values)):
        case_data, (top, bottom) = data.sel(case=case), rows[:, k]
        theta, truth = case_data["theta"].values, case_data["truth"].values
        band = float(case_data["gamma_of_case"])
        top.plot(theta, truth, color=INK)
        top.fill_between(theta, truth - band, truth + band, color=INK, alpha=0.12, linewidth=0)
        for color, mark, name in zip(CYCLE, _P7_MARKERS, data["estimator"].values, strict=False):
            label = str(name) if k == 0 else None
            estimate = case_data.sel(estimator=name)
            top.plot(theta, estimate["mean"][:, 0], mark, color=color, markersize=3, label=label)
            if np.isfinite(estimate["alpha"]).all():
                bottom.plot(theta, estimate["alpha"].mean("run"), f"{mark}-", color=color, markersize=3)
        largest_gradient = np.abs(truth).max()
        top.set(ylim=(truth.min() - 0.7 * largest_gradient, truth.max() + 0.7 * largest_gradient), title=case)
        bottom.set(ylim=(-0.05, 1.05), xlabel=f"$\\theta${_P7_UNITS[case]}")
    rows[0, 0].set_ylabel("gradient")
    rows[1, 0].set_ylabel("weight alpha")
    figure.legend(loc="outside upper center", ncols=5)
    return figure
