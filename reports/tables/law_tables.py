"""Cells of the tables that compare contact laws, for plans (study N3) and for closed loops (study C1)."""

from __future__ import annotations

import math

import xarray as xr


def excess_text(share: float) -> str:
    """Return a relative excess as text: in percent, or as a factor if it is threefold or more; a dash if not finite."""
    if not math.isfinite(share):
        return "–"
    if share >= 2:
        return f"×{1 + share:.3g}"
    if abs(share) < 0.0005:
        return "0.0%"
    return f"{share:+.1%}" if abs(share) < 0.0995 else f"{share:+.0%}"


def broken_name(problem: str) -> str:
    """Return a problem's name with a line break after each dash, to fit above a narrow column."""
    return problem.replace("-", "-\n")


def seconds_of(data: xr.Dataset) -> xr.DataArray:
    """Return the time (problem, law) [s] for learning and solving together, the median over seeds."""
    return data["seconds"].sum("part").median("seed")
