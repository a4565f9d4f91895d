"""Drawing of study A1."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from reports.figures.studies.panels import light_to_dark
from reports.style import INK, VERMILLION, WIDTH

caption = (
    "Top: the adaptive mu(z) and the contact impulse over the gap. Bottom: how far each softening "
    "is from the exact law, and the density of the noise that it stands for (lines: F times the "
    "curvature of the contact law; dots: Student's t with 2 degrees of freedom, and the Gaussian)."
)


def draw(data: xr.Dataset) -> Figure:
    """mu, impulse, error and noise density over z."""
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
    top.set_yscale("log")
    top.set_ylim(1e-4, 2)
    error.set_ylim(1e-4, 2)
    density.set_ylim(1e-4, 5)
    top.set_ylabel("$\\mu(z)$ [N s m]")
    impulse.set_ylabel("$\\lambda$ [N s]")
    error.set_ylabel("$\\lambda - \\lambda_{exact}$ [N s]")
    density.set_ylabel("density of $w$ [1/m]")
    for axis in (top, impulse):
        axis.tick_params(labelbottom=True)
    for axis in (error, density, top, impulse):
        axis.set_xlabel("gap $z$ [m]")
    impulse.legend()
    return figure
