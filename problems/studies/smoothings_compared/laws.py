"""The laws that are compared, in the order of the table."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import xarray as xr

ANALYTIC = ("gentle barrier", "barrier", "sharp barrier", "adaptive", "randomized")
LEARNED = ("ewda", "wide ewda", "trusting ewda", "clean mlp", "noised mlp")
LAWS = ("exact", *ANALYTIC, *LEARNED)
DRAWN = ("randomized", *LEARNED)
"""Those that a seed changes."""
WITHIN = 0.1
"""How much dearer than the exact optimum a plan's exact replay may be, to be called close to it."""
TENFOLD = 10.0
"""How much gentler and sharper than mu the other two barriers are."""


def described(settings: Mapping[str, Any]) -> dict[str, str]:
    """Name every law with its settings, from the study's parameters."""
    mu, width, wide = settings["mu"], settings["width"], settings["wide"]
    texts = (
        "exact",
        *(f"barrier, mu = {mu * factor:g}" for factor in (TENFOLD, 1, 1 / TENFOLD)),
        f"adaptive, sigma = {settings['spread']:g}",
        f"randomized, sigma = {settings['sigma']:g}",
        f"EWDA, sigma = {width:g}",
        f"EWDA, sigma = {wide:g}",
        f"EWDA, sigma = {width:g}, trust",
        "MLP, clean data",
        f"MLP, noised, sigma = {width:g}",
    )
    return dict(zip(LAWS, texts, strict=True))


def excess(data: xr.Dataset) -> xr.DataArray:
    """Exact replay over the exact law's own optimum, less one (problem, law, seed)."""
    best = data["cost"].sel(law="exact", motion="exact replay")
    return data["cost"].sel(motion="exact replay") / best - 1


def gap(cost: xr.DataArray) -> xr.DataArray:
    """How much dearer the replay is than the plan, as a share of the plan's cost."""
    plan, replay = cost.sel(motion="plan"), cost.sel(motion="exact replay")
    return (replay - plan) / abs(plan)
