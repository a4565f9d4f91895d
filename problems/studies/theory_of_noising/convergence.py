"""How far trained networks are from g_sigma, over the pairs they saw and over their width."""

from __future__ import annotations

from typing import Any

import numpy as np

from problems.studies.shared.noised_line import Pusher, answers, average_of, network_of
from problems.studies.study import quantity_of

PAIRS = np.array([32, 128, 512, 2048])
UNITS = np.array([2, 4, 16])
"""Units in each of two layers."""
_DATA, _QUERIES = 200, 2000


def networks(rho: float, sigma: float, epochs: int, repeats: int, seed: int) -> dict[str, Any]:
    """Root mean square of h_sigma - g_sigma over the noised data, of the same 200 commands.

    Every network sees another draw of ``n`` noised pairs, all of them in each step.
    """
    pusher, rng = Pusher(rho), np.random.default_rng([seed, 4])
    u = rng.uniform(-1, 1, _DATA)
    model = average_of(u, pusher.step(u), sigma)
    at = rng.choice(u, _QUERIES) + sigma * rng.standard_normal(_QUERIES)
    g = answers(model, at)
    off = np.empty((len(UNITS), len(PAIRS), repeats))
    for row, column, repeat in np.ndindex(off.shape):
        n, units = int(PAIRS[column]), int(UNITS[row])
        drawn = rng.choice(u, n)
        z = drawn + sigma * rng.standard_normal(n)
        recipe = {
            "hidden": (units, units),
            "epochs": epochs,
            "batch": n,
            "rate": 1e-2,
            "held_out": 0.0,
        }
        h = network_of(z, pusher.step(drawn), 0.0, repeat, **recipe)
        off[row, column, repeat] = np.sqrt(np.mean((answers(h, at) - g) ** 2))
    noise = np.sqrt(np.mean((g - pusher.step(at)) ** 2))
    return {
        "network_error": quantity_of(("units", "pairs", "repeat"), off, "m",
                                     "root mean square of h_sigma - g_sigma"),
        "noising_effect": quantity_of((), noise, "m", "root mean square of g_sigma - f"),
    }  # fmt: skip
