"""Drawings of studies A1, A2, A2v, A6 and T1, on smoothed contact laws."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from reports.drawing.style import BLUE, CYCLE, GREEN, GREY, INK, ORANGE, PURPLE, VERMILLION, WIDTH
from reports.figures.studies.panels import drawing, impulse_arrow, light_to_dark


@drawing(
    "Top: the adaptive mu(z) and the contact impulse over the gap. Bottom: distance of each "
    "softening from the exact law, and the density of the noise that it corresponds to (lines: F "
    "times the curvature of the contact law; dots: Student's t with 2 degrees of freedom, and the "
    "Gaussian)."
)
def a1(data: xr.Dataset) -> Figure:
    """Draw study A1: mu, contact impulse, error and density of the noise over the gap z."""
    figure = Figure(figsize=(WIDTH, 5.0))
    (top, impulse), (error, density) = figure.subplots(2, 2)
    z, mus = data["z"].values, data["mu"].values
    shades = light_to_dark(len(mus), 0.8, 0.1)
    exact = data["lam_exact"].values
    top.plot(z, data["mu_adaptive"], color=VERMILLION)
    impulse.plot(z, exact, "--", color=INK, label="exact")
    for index, (mu, shade) in enumerate(zip(mus, shades, strict=True)):
        lam = data["lam_constant"][index].values
        top.axhline(mu, color=shade)
        impulse.plot(z, lam, color=shade, label=f"$\\mu$ = {mu:g} N s m")
        error.semilogy(z, lam - exact, color=shade)
        density.semilogy(z, data["density_constant"][index], color=shade)
        density.semilogy(z[::20], data["student"][index][::20], ".", color=shade)
    impulse.plot(z, data["lam_adaptive"], color=VERMILLION, label="adaptive")
    error.semilogy(z, np.maximum(data["lam_adaptive"] - exact, 1e-300), color=VERMILLION)
    density.semilogy(z, data["density_adaptive"], color=VERMILLION)
    density.semilogy(z[::20], data["gaussian"][::20], ".", color=VERMILLION)
    top.set(yscale="log", ylim=(1e-4, 2), ylabel="$\\mu(z)$ [N s m]")
    error.set(ylim=(1e-4, 2), ylabel="$\\lambda - \\lambda_{exact}$ [N s]")
    density.set(ylim=(1e-4, 5), ylabel="density of $w$ [1/m]")
    impulse.set_ylabel("$\\lambda$ [N s]")
    for axis in (top, impulse):
        axis.tick_params(labelbottom=True)
    for axis in (error, density, top, impulse):
        axis.set_xlabel("gap $z$ [m]")
    impulse.legend()
    return figure


@drawing(
    "Height, vertical velocity and its derivative along the horizontal position. Top: the softened "
    "equation of motion (C.1), which is elastic. Bottom: time stepping, softened (lines) and exact "
    "(dashed), which is plastic; the arrow represents the impulse."
)
def a2(data: xr.Dataset) -> Figure:
    """Draw study A2: height, vertical velocity and its derivative along a throw, one row per model."""
    figure = Figure(figsize=(WIDTH, 4.6))
    axes = figure.subplots(2, 3, sharex=True)
    mus = data["mu"].values
    shades = light_to_dark(len(mus))
    rows = (
        (axes[0], ("y", "v", "rate"), ("q_x", "q_x", "q_x")),
        (axes[1], ("y_step", "v_step", "rate_step"), ("q_step", "q_step", "q_mid")),
    )
    for row, names, legends in rows:
        for axis, name, legend in zip(row, names, legends, strict=True):
            for index, shade in enumerate(shades):
                axis.plot(data[legend], data[name][index], color=shade)
    for axis, name, legend in zip(axes[1], ("y_exact", "v_exact", "rate_exact"), rows[1][2], strict=True):
        axis.plot(data[legend], data[name], "--", color=INK, linewidth=1.0)
    spike = data["rate_exact"].values
    impact_place = float(data["q_mid"][int(spike.argmax())])
    impulse_arrow(axes[1, 2], impact_place, spike.max(), spike.max() * 4)
    for row in axes:
        for axis, text in zip(row, ("$y$ [m]", "$v_y$ [m/s]", "$dv_y/dq_x$ [1/s]"), strict=True):
            axis.set_ylabel(text)
        row[2].set_yscale("symlog", linthresh=10)
    axes[1, 2].set_ylim(top=spike.max() * 6)
    for axis in axes[1]:
        axis.set_xlabel("$q_x$ [m]")
    handles = [Line2D([], [], color=shade) for shade in shades]
    labels = [f"$\\mu$ = {mu:g} J/kg" for mu in mus]
    handles.append(Line2D([], [], color=INK, linestyle="--"))
    figure.legend(handles, [*labels, "exact law"], loc="outside upper center", ncols=5)
    return figure


@drawing(
    "Variance of one sample's gradient by the throw's velocity, the largest over both components and "
    "over the ends of the rollout, for first-order (left) and likelihood-ratio gradients (right)."
)
def a2v(data: xr.Dataset) -> Figure:
    """Draw study A2v: the variance of gradients over mu, for every step size."""
    figure = Figure(figsize=(WIDTH, 3.0))
    first_order_axis, likelihood_axis = figure.subplots(1, 2, sharey=True)
    h = data["h"].values
    shades = light_to_dark(len(h))
    for index, shade in enumerate(shades):
        first_order_axis.loglog(data["mu"], data["first_order"][index], "o-", color=shade)
        likelihood_axis.loglog(
            data["mu"], data["likelihood_ratio"][index], "s-", color=shade, label=f"h = {h[index]:g} s"
        )
    first_order_axis.set(title="first order", ylabel="variance [s$^2$/m$^2$]")
    likelihood_axis.set_title("likelihood ratio")
    for axis in (first_order_axis, likelihood_axis):
        axis.set_xlabel("$\\mu$ [N s m]")
    likelihood_axis.legend()
    return figure


_SAMPLED_COLORS = (ORANGE, PURPLE, GREEN)
"""Colours of randomized smoothing in study A6, one for each number of samples."""


@drawing(
    "Left: derivative of the vertical velocity along a throw, around its impact; the arrow stands "
    "for the impulse of the exact law. Right: derivative of the box's next velocity by the push. "
    "Barrier smoothing in full lines, randomized smoothing as points; the exact ball that it "
    "averages has the finest of three steps."
)
def a6(data: xr.Dataset) -> Figure:
    """Draw study A6: derivatives through an impact on the left, through friction on the right."""
    figure = Figure(figsize=(WIDTH, 4.2))
    impact, push = figure.subplots(1, 2)
    laws = [str(name) for name in data["law"].values]
    shades = [*light_to_dark(len(laws) - 1, 0.05, 0.6), VERMILLION]
    for index, (name, shade) in enumerate(zip(laws, shades, strict=True)):
        text = name if name == "adaptive" else name.replace("mu", "BS $\\mu$")
        impact.plot(
            data["q_mid"],
            data["impact_soft"][index],
            color=shade,
            label=text,
            linestyle="-." if name == "adaptive" else "-",
        )
    mus = data["box_mu"].values
    for index, (mu, shade) in enumerate(zip(mus, shades, strict=False)):
        push.plot(data["u"], data["push_soft"][index], color=shade, label=f"BS $\\mu$ = {mu:.1e}")
    for index, (count, color) in enumerate(zip(data["count"].values, _SAMPLED_COLORS, strict=True)):
        impact.plot(data["q_x"], data["impact_rs"][-1, index], ".", color=color, markersize=3, label=f"RS N = {count}")
        push.plot(data["u"], data["push_rs"][index], ".", color=color, markersize=3, label=f"RS N = {count}")
    impact.plot(data["q_x"], data["impact_limit"], ":", color=GREY, label="RS N = $\\infty$")
    push.plot(data["u"], data["push_limit"], ":", color=GREY, label="RS N = $\\infty$")
    push.plot(data["u"], data["push_exact"], "--", color=INK, linewidth=0.9, label="exact")
    impact.set_yscale("symlog", linthresh=10)
    top = impact.get_ylim()[1] * 3
    impact.set(ylim=(-30, top), xlabel="$q_x$ [m]", ylabel="$dv_y/dq_x$ [1/s]")
    impulse_arrow(impact, float(data["place"]), 0, top)
    impact.set_xlim(float(data["q_x"][0]), float(data["q_x"][-1]))
    push.set(xlabel="push $u$ [N]", ylabel="$\\partial v^+/\\partial u$ [m/(N s)]")
    for axis in (impact, push):
        axis.legend(loc="upper center", bbox_to_anchor=(0.5, -0.18), ncols=2)
    return figure


@drawing(
    "Top left: how often each bound holds over all sizes. Top right: largest slope and curvature "
    "over mu at four contacts, with the bound of thm. 4.5 as printed. Bottom left: slope over "
    "bound, median and range over the draws. Bottom right: gradient variance over the horizon "
    "(dots), with the growth that thm. 4.4 would allow, L^4H, from the first point (dotted)."
)
def t1(data: xr.Dataset) -> Figure:
    """Draw study T1: the fraction of cases in which bounds hold, scaling with mu, looseness, and variance."""
    figure = Figure(figsize=(WIDTH, 6.0))
    (often, scaling), (loose, growth) = figure.subplots(2, 2)
    names = [str(name) for name in data["bound"].values[:-1]]
    for index, (kind, color) in enumerate(zip(data["kind"].values, (BLUE, VERMILLION), strict=True)):
        ratio = data["ratio"].sel(kind=kind).values[:, :-1]
        share = [
            np.mean(values[np.isfinite(values)] <= 1 + 1e-9) if np.isfinite(values).any() else 0
            for values in ratio.transpose(1, 0, 2).reshape(len(names), -1)
        ]
        positions = np.arange(len(names)) + 0.2 - 0.4 * index
        often.barh(positions, share, 0.38, color=color)
        scaling.loglog(data["mu"], data["slope"][index], "o-", color=color)
        scaling.loglog(data["mu"], data["curvature"][index], "s--", color=color)
        scaling.loglog(data["mu"], data["printed"][index], ":", color=color)
        slope_ratio = data["ratio"].sel(kind=kind, bound="5.1").values
        size = data["size"].values + 0.12 - 0.24 * index
        middle = np.median(slope_ratio, axis=1)
        reach = [middle - slope_ratio.min(axis=1), slope_ratio.max(axis=1) - middle]
        loose.errorbar(size, middle, reach, fmt="o", color=color, linewidth=0.8, capsize=2, label=str(kind))
    for style, name in (("o-", "slope"), ("s--", "curvature"), (":", "bound as printed")):
        scaling.plot([], [], style, color=GREY, label=name)
    often.set_yticks(np.arange(len(names)), names)
    often.invert_yaxis()
    often.set(xlim=(0, 1.02), xlabel="share of systems in which it holds")
    scaling.set(xlabel="$\\mu$", ylabel="largest over systems")
    loose.set(yscale="log", xlabel="number of contacts", ylabel="slope / bound of thm. 5.1")
    loose.axhline(1, color=GREY, linewidth=0.8)
    horizon = data["horizon"].values
    for index, (gain, color) in enumerate(zip(data["gain"].values, CYCLE, strict=False)):
        row = data["growth"].values[index]
        growth.semilogy(horizon, row, "o-", color=color, label=f"$L_f$ = {gain:g}")
        growth.semilogy(horizon, row[0] * max(gain, 1) ** (4.0 * (horizon - horizon[0])), ":", color=color)
    growth.set(xlabel="horizon $H$ [steps]", ylabel="variance of the gradient")
    scaling.legend()
    loose.legend()
    growth.legend()
    return figure
