"""Drawing of study A2v."""

from __future__ import annotations

import xarray as xr
from matplotlib.figure import Figure

from reports.figures.studies.panels import light_to_dark
from reports.style import WIDTH

caption = (
    "Variance of one sample's gradient by the throw's velocity, the largest over both components "
    "and over when the rollout ends, for first-order (left) and likelihood-ratio gradients (right)."
)


def draw(data: xr.Dataset) -> Figure:
    """Variance over mu for every step size."""
    figure = Figure(figsize=(WIDTH, 3.0))
    left, right = figure.subplots(1, 2, sharey=True)
    h = data["h"].values
    shades = light_to_dark(len(h))
    for index, shade in enumerate(shades):
        left.loglog(data["mu"], data["first_order"][index], "o-", color=shade)
        right.loglog(data["mu"], data["likelihood_ratio"][index], "s-", color=shade,
                     label=f"h = {h[index]:g} s")  # fmt: skip
    left.set_title("first order")
    right.set_title("likelihood ratio")
    left.set_ylabel("variance [s$^2$/m$^2$]")
    for axis in (left, right):
        axis.set_xlabel("$\\mu$ [N s m]")
    right.legend()
    return figure
