"""Drawing of study A6."""

from __future__ import annotations

import xarray as xr
from matplotlib.figure import Figure

from reports.figures.studies.panels import impulse_arrow, light_to_dark
from reports.style import GREEN, GREY, INK, ORANGE, PURPLE, VERMILLION, WIDTH

caption = (
    "Left: derivative of the vertical velocity along a throw, around its impact; the arrow stands "
    "for the impulse of the exact law. Right: derivative of the box's next velocity by the push. "
    "Barrier smoothing in full lines, randomized smoothing as points; the exact ball that it "
    "averages has the finest of three steps."
)
_RS = (ORANGE, PURPLE, GREEN)


def draw(data: xr.Dataset) -> Figure:
    """Impact on the left, friction on the right."""
    figure = Figure(figsize=(WIDTH, 4.2))
    impact, push = figure.subplots(1, 2)
    laws = [str(name) for name in data["law"].values]
    shades = [*light_to_dark(len(laws) - 1, 0.05, 0.6), VERMILLION]
    for index, (name, shade) in enumerate(zip(laws, shades, strict=True)):
        text = name if name == "adaptive" else name.replace("mu", "BS $\\mu$")
        impact.plot(data["q_mid"], data["impact_soft"][index], color=shade, label=text)
    mus = data["box_mu"].values
    for index, (mu, shade) in enumerate(zip(mus, shades, strict=False)):
        push.plot(data["u"], data["push_soft"][index], color=shade, label=f"BS $\\mu$ = {mu:.1e}")
    for index, (count, color) in enumerate(zip(data["count"].values, _RS, strict=True)):
        impact.plot(data["q_x"], data["impact_rs"][-1, index], ".", color=color,
                    markersize=3, label=f"RS N = {count}")  # fmt: skip
        push.plot(data["u"], data["push_rs"][index], ".", color=color, markersize=3,
                  label=f"RS N = {count}")  # fmt: skip
    impact.plot(data["q_x"], data["impact_limit"], ":", color=GREY, label="RS N = $\\infty$")
    push.plot(data["u"], data["push_limit"], ":", color=GREY, label="RS N = $\\infty$")
    push.plot(data["u"], data["push_exact"], "--", color=INK, linewidth=0.9, label="exact")
    impact.set_yscale("symlog", linthresh=10)
    top = impact.get_ylim()[1] * 3
    impact.set_ylim(-30, top)
    impulse_arrow(impact, float(data["place"]), 0, top)
    impact.set_xlim(float(data["q_x"][0]), float(data["q_x"][-1]))
    impact.set(xlabel="$q_x$ [m]", ylabel="$dv_y/dq_x$ [1/s]")
    push.set(xlabel="push $u$ [N]", ylabel="$\\partial v^+/\\partial u$ [m/(N s)]")
    for axis in (impact, push):
        axis.legend(loc="upper center", bbox_to_anchor=(0.5, -0.18), ncols=2)
    return figure
