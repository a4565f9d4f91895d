"""Where data end: the block between its walls, and g_sigma against f_sigma near the last datum."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.stats import norm

from problems.studies.shared.noised_line import Pusher, Walls, answers, average_of
from problems.studies.study import quantity_of
from problems.studies.theory_of_noising.lemmas import SPACINGS, WIDTHS

DEPTHS = np.array([0.0, 0.1, 0.3, 1, 2, 3, 5, 10, 20, 50, 100, 1000])
"""Penetration of a wall over sigma."""
DISTANCES = np.linspace(0, 6, 121)
"""Distance from the end of the data, inwards, over sigma."""
ENDS = ("upper", "lower")
GAPS = np.array([0.5, 2.0, 8.0])
"""Distance of the walls [m]."""
SAMPLES = np.array([10, 100, 1000, 10000])
"""Random states between the walls."""
_STATES = 4000


def walls() -> dict[str, Any]:
    """The block between walls: evenly spaced data against the mean of a truncated normal.

    The midpoint rule misses an integral by ``D²/24`` times the change of the integrand's derivative
    between the ends; carried through the quotient, at each wall w of density k,

        D²/24 k(w)/mass (1 + (w - g)(x - w)/sigma²).
    """
    off = np.empty((len(WIDTHS), len(SPACINGS)))
    law = np.empty_like(off)
    block = Walls()
    for row, sigma in enumerate(WIDTHS):
        x = np.linspace(-1 - 4 * sigma, 1 + 4 * sigma, 801)
        g = block.noised(x, sigma)
        for column, spacing in enumerate(SPACINGS):
            count = round((block.high - block.low) / (spacing * sigma))
            data = block.low + (np.arange(count) + 0.5) * (block.high - block.low) / count
            off[row, column] = np.abs(answers(average_of(data, data, sigma), x) - g).max() / sigma
            law[row, column] = (
                np.abs(_midpoint(block, x, g, sigma, data[1] - data[0])).max() / sigma
            )
    return {
        "walls_error": quantity_of(("width", "spacing"), off, "1",
                                   "largest |g - closed form| over sigma, evenly spaced data"),
        "walls_law": quantity_of(("width", "spacing"), law, "1",
                                 "the same by the error of the midpoint rule"),
        **_outside(),
        **_fixed_points(),
    }  # fmt: skip


def _midpoint(
    block: Walls, x: np.ndarray, g: np.ndarray, sigma: float, spacing: float
) -> np.ndarray:
    edges = np.array([[block.low], [block.high]])
    low, high = norm.cdf(edges, x, sigma)
    change = norm.pdf(edges, x, sigma) / (high - low) * (1 + (edges - g) * (x - edges) / sigma**2)
    return spacing**2 / 24 * (change[1] - change[0])


def _outside() -> dict[str, Any]:
    """How far inside a penetrating state is put, and how much it matters where it was."""
    inside, slope = np.empty((2, len(GAPS), len(WIDTHS), len(DEPTHS)))
    for row, gap in enumerate(GAPS):
        block = Walls(-gap / 2, gap / 2)
        for column, sigma in enumerate(WIDTHS):
            x = block.high + DEPTHS * sigma
            inside[row, column] = (block.high - block.noised(x, sigma)) / sigma
            slope[row, column] = block.slope(x, sigma)
    both = ("gap", "width", "depth")
    return {
        "inside": quantity_of(both, inside, "1", "way inside the wall after a step, over sigma"),
        "slope_outside": quantity_of(both, slope, "1", "slope of g_sigma in penetration"),
    }


def _fixed_points() -> dict[str, Any]:
    """Where g(x) - x changes its sign, and whether it ever leads to a wall."""
    count, outwards = np.empty((2, len(GAPS), len(WIDTHS)))
    for index in np.ndindex(count.shape):
        gap, sigma = float(GAPS[index[0]]), float(WIDTHS[index[1]])
        block = Walls(-gap / 2, gap / 2)
        x = np.linspace(block.low, block.high, _STATES)
        way = np.sign(block.displacement(x, sigma))
        # Deep between the walls the way underflows to 0, which is no sign.
        count[index] = np.count_nonzero(np.diff(way[way != 0]))
        outwards[index] = np.mean(way * x > 0)
    both = ("gap", "width")
    return {
        "fixed_points": quantity_of(both, count, "1", "changes of sign of g_sigma(x) - x"),
        "outwards": quantity_of(both, outwards, "1", "share of states that move outwards"),
    }


def climbing(sigma: float, seed: int) -> dict[str, Any]:
    """Random states between the walls as data: where rollouts end, and the density on the way."""
    x = np.linspace(-1, 1, _STATES)
    attractors, climb, centre = np.empty((3, len(SAMPLES)))
    for i, n in enumerate(SAMPLES):
        data = np.random.default_rng([seed, 3, i]).uniform(-1, 1, n)
        model = average_of(data, data, sigma)
        here = model.values(x[:, None])
        way = here[:, 0] - x
        turns = np.flatnonzero((way[:-1] > 0) & (way[1:] <= 0))
        attractors[i], centre[i] = turns.size, np.abs(x[turns]).max()
        climb[i] = (model.values(here[:, :1])[:, 1] - here[:, 1]).min()
    return {
        "attractors": quantity_of("sample", attractors, "1", "states at which rollouts end"),
        "off_centre": quantity_of(
            "sample", centre, "m", "distance of the farthest from the middle"
        ),
        "climb": quantity_of("sample", climb, "1", "least growth of log p_sigma in a step"),
    }


def near_the_ends(rho: float) -> dict[str, Any]:
    """``(g_sigma - f_sigma)/(rho sigma)`` at distances from both ends of uniform data, 2 m long."""
    pusher, block = Pusher(rho), Walls()
    bias = np.empty((len(ENDS), len(WIDTHS), len(DISTANCES)))
    for column, sigma in enumerate(WIDTHS):
        for row, end in enumerate((block.high, block.low)):
            u = end * (1 - DISTANCES * sigma)
            g = pusher.noised(u, sigma, block.low, block.high)
            bias[row, column] = (g - pusher.smoothed(u, sigma)) / (rho * sigma)
    return {
        "bias": quantity_of(("end", "width", "distance"), bias, "1",
                            "(g_sigma - f_sigma)/(rho sigma) of uniform data near its ends"),
    }  # fmt: skip
