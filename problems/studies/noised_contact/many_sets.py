"""g_sigma of many random sets of data: how far it is from f_sigma, and how far it may be."""

from __future__ import annotations

from typing import Any

import numpy as np

from problems.studies.shared.noised_line import Pusher, average_of
from problems.studies.study import quantity_of

SETS = 20
WIDTHS = np.array([0.05, 0.1, 0.2])
"""sigma [m], for commands in [-1, 1] m."""
DEPTHS = np.array([0.0, 0.05, 0.1, 0.2, 0.5, 1.0, 10.0])
"""Penetration [m]."""


def many_sets(pusher: Pusher, sparse: int, dense: int, seed: int) -> dict[str, Any]:
    """Distance of g_sigma from f_sigma over its standard error, slopes, states in penetration.

    A weighted mean of random data has the standard error ``|w (y - g)|/sum w``; over it g_sigma
    is off by a number of variance 1 where nothing but the choice of data parts it from f_sigma.
    """
    shape = (len(WIDTHS), SETS)
    square, bias, error, at_end, steepest, flattest, inside = np.empty((7, *shape))
    for row, sigma in enumerate(WIDTHS):
        middle = np.linspace(-1 + 3 * sigma, 1 - 3 * sigma, 101)
        true = pusher.smoothed(middle, sigma)
        for i in range(SETS):
            rng = np.random.default_rng([seed, 1, i])
            u, few = rng.uniform(-1, 1, dense), rng.uniform(-1, 1, sparse)
            g, deviation = _with_error(u, pusher.step(u), sigma, middle)
            off = g - true
            # Where the pusher stays away f is 0 and so is every error.
            told = deviation > 1e-3 * sigma
            square[row, i] = np.mean((off / deviation)[told] ** 2)
            bias[row, i], error[row, i] = np.sqrt(np.mean(off**2)), np.sqrt(np.mean(deviation**2))
            end, doubt = _with_error(u, pusher.step(u), sigma, np.array([1.0]))
            at_end[row, i] = (end[0] - pusher.smoothed(1.0, sigma)) / doubt[0]
            steepest[row, i], flattest[row, i] = _slopes(pusher, few, sigma)
            inside[row, i] = _inside(rng.uniform(-1, 1, dense), sigma)
    both = ("width", "set")
    return {
        "score_square": quantity_of(both, square, "1",
                                    "mean of ((g - f_sigma)/standard error)², 3 sigma off ends"),
        "dense_rms": quantity_of(both, bias, "m", "rms of g_sigma - f_sigma, 3 sigma off ends"),
        "dense_error": quantity_of(both, error, "m", "rms of the standard error of g_sigma"),
        "end_score": quantity_of(both, at_end, "1",
                                 "(g - f_sigma)/standard error at the upper end"),
        "steepest": quantity_of(both, steepest, "1", "slope of g_sigma over rho, sparse data"),
        "flattest": quantity_of(both, flattest, "1", "the least in contact, within the data"),
        "least_inside": quantity_of(both, inside, "m", "way inside the wall after one step"),
    }  # fmt: skip


def _with_error(
    z: np.ndarray, y: np.ndarray, sigma: float, at: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """g_sigma at ``at`` (k,) and its standard error, for data drawn at random."""
    g = average_of(z, y, sigma).values(at[:, None])[:, 0]
    weight = np.exp(-0.5 * ((at[:, None] - z) / sigma) ** 2)
    spread = np.sqrt(np.sum((weight * (y - g[:, None])) ** 2, axis=1))
    return g, spread / weight.sum(axis=1)


def _slopes(pusher: Pusher, z: np.ndarray, sigma: float) -> tuple[float, float]:
    """Largest and least slope over rho, in contact from sigma on and between first and last."""
    model = average_of(z, pusher.step(z), sigma)
    at = np.linspace(pusher.c + sigma, z.max(), 400)
    slope = model.jacobians(at[:, None])[1][:, 0, 0] / pusher.rho
    return slope.max(), slope.min()


def _inside(states: np.ndarray, sigma: float) -> float:
    """How far inside walls at -1 and 1 m the average of ``states`` puts what penetrates them."""
    model = average_of(states, states, sigma)
    after = model.values(np.concatenate((-1 - DEPTHS, 1 + DEPTHS))[:, None])[:, 0]
    return float(np.min(1 - np.abs(after)))
