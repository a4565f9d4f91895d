"""Drawing of study AT."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from problems.studies.convergence_bound import bound
from reports.style import CYCLE, INK, WIDTH

caption = (
    "Left: mean square norm of the gradient of J over the steps of ascent, mean over runs. Middle: "
    "bias and variance of the batch's gradient, means over runs. Right: the smallest mean square "
    "norm (dot) and the bound on it (bar)."
)


def draw(data: xr.Dataset) -> Figure:
    """Norms, bias and variance over steps, and both sides of the bound."""
    figure = Figure(figsize=(WIDTH, 3.0))
    norms, terms, sides = figure.subplots(1, 3, width_ratios=(1.2, 1.2, 1))
    laws = [str(law) for law in data["law"].values]
    for law, color in zip(laws, CYCLE, strict=False):
        one = data.sel(law=law)
        norms.semilogy((one["slope"] ** 2).mean("run"), color=color, label=law)
        terms.semilogy(one["bias"].mean("run"), "-", color=color)
        terms.semilogy(one["variance"].mean("run"), ":", color=color)
    norms.set_xlabel("step")
    norms.set_ylabel("mean square gradient [$m^4$]")
    terms.set_xlabel("step")
    terms.set_ylabel("bias (line), variance (dots)")
    both = np.array([bound(data, law) for law in laws])
    places = np.arange(len(laws))
    sides.bar(places, both[:, 1], color=list(CYCLE[: len(laws)]), alpha=0.4)
    sides.plot(places, both[:, 0], "o", color=INK)
    sides.set_yscale("log")
    sides.set_xticks(places, laws, rotation=60)
    sides.set_ylabel("[$m^4$]")
    figure.legend(*norms.get_legend_handles_labels(), loc="outside upper center", ncols=5)
    return figure
