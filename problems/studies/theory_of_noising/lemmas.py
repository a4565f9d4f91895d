"""Checks of lemmas 1 to 3 of Suh et al. 2023, of the score, and of data uniform between two walls."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.stats import norm

from dynamics.learned.ewda import EwdaModel
from dynamics.learned.transitions import DataOrigin, Normalisation
from dynamics.systems.parameters import Signal
from problems.studies.shared.noised_line import LinePusher, Walls, average_of, model_values

WIDTHS = np.array([0.05, 0.1, 0.2])
"""Standard deviations sigma of the noise [m], from a fortieth to a tenth of the length of the data."""
SPACINGS = np.array([1.0, 0.5, 0.25, 0.125])
"""Distances between neighbouring data, in units of sigma."""
COMMANDS = np.array([0.25, 0.556, 0.99])
"""Slopes rho of the step of a pushed block, from a heavy to a light block; the authors use the second."""
PLACES = np.array([0.0, 0.5])
"""Positions of the kink between two data, in units of their spacing, for which the error of the sum is largest."""
CASES = ("3 data", "10 data", "100 data", "a ramp", "a bell")
"""Names of the data sets and densities on which risks are compared."""
CHANGES = np.array([-0.1, -0.07, -0.04, -0.01, 0.01, 0.04, 0.07, 0.1])
"""Root mean squares of the perturbations of g_sigma [m]; a negative sign reverses the perturbation."""
CANDIDATES = ("f", "f_sigma", "nearest")
"""Names of the maps whose noised risks are compared with that of g_sigma."""
DIMENSIONS = (1, 2, 5, 11)
"""Numbers of dimensions in which the score is checked."""
SPREADS = np.array([0.1, 0.3, 1.0])
"""Ratios of sigma to the data's standard deviation."""
_PERTURBATIONS = 40
"""Number of random perturbations of g_sigma for each case and width."""


def uniform_data() -> dict[str, Any]:
    """Check lemma 1: compute ``|g_sigma - f_sigma|/(rho sigma)`` for evenly spaced data at distances D.

    By the Euler-Maclaurin formula the sum in g_sigma differs from its integral by ``D² B2(t)/2`` times the
    jump of the derivative, here ``rho pdf(0)/sigma``, if the kink is at the distance t D behind a datum.
    """
    positions = np.linspace(-4, 4, 161)
    errors = np.empty((len(COMMANDS), len(WIDTHS), len(PLACES), len(SPACINGS)))
    for index in np.ndindex(errors.shape):
        every = zip((COMMANDS, WIDTHS, PLACES, SPACINGS), index, strict=True)
        rho, sigma, position, spacing = (float(choices[i]) for choices, i in every)
        pusher, n_side = LinePusher(rho), round(14 / spacing)
        u = (np.arange(-n_side, n_side + 1) + position) * spacing * sigma
        g = model_values(average_of(u, pusher.step(u), sigma), positions * sigma)
        errors[index] = np.abs(g - pusher.smoothed(positions * sigma, sigma)).max() / (rho * sigma)
    bernoulli = np.abs(PLACES**2 - PLACES + 1 / 6) / 2
    law = bernoulli[:, None] * SPACINGS**2 / np.sqrt(2 * np.pi)
    return {
        "sum_error": (
            ("command", "width", "place", "spacing"),
            errors,
            "1",
            "largest |g - f_sigma| over rho sigma, evenly spaced data",
        ),
        "sum_law": (("place", "spacing"), law, "1", "the same by Euler and Maclaurin, to leading order"),
    }


def noised_risks(rho: float, seed: int) -> dict[str, Any]:
    """Check lemmas 2 and 3: compute the increase of noised risk due to other maps, or perturbations of g_sigma.

    The expectation over the noise is a trapezoidal sum, exact up to rounding errors for smooth integrands.
    """
    pusher, rng = LinePusher(rho), np.random.default_rng([seed, 1])
    higher = np.empty((len(CASES), len(WIDTHS), len(CHANGES), _PERTURBATIONS))
    others, risk = np.empty((len(CASES), len(WIDTHS), len(CANDIDATES))), np.empty(higher.shape[:2])
    for row, case in enumerate(CASES):
        x, chance = _distribution(case, rng)
        y = pusher.step(x)
        for column, sigma in enumerate(WIDTHS):
            z = np.arange(x.min() - 9 * sigma, x.max() + 9 * sigma, sigma / 8)
            joint = np.exp(-0.5 * ((z - x[:, None]) / sigma) ** 2)
            joint *= (chance / joint.sum(axis=1))[:, None]
            g = model_values(average_of(x, y, sigma), z) if "data" in case else y @ joint / joint.sum(0)
            risk[row, column] = smallest_risk = _risk(joint, y, g)
            for i in range(_PERTURBATIONS):
                size, rate = rng.standard_normal(4), rng.uniform(0, 2, 4)
                phase = rng.uniform(0, 2 * np.pi, 4)
                # A smooth random function.
                wave = size @ np.cos(rate[:, None] * (z / sigma) + phase[:, None])
                wave /= np.sqrt(joint.sum(axis=0) @ wave**2)
                higher[row, column, :, i] = [_risk(joint, y, g + change * wave) - smallest_risk for change in CHANGES]
            nearest = y[np.abs(z - x[:, None]).argmin(axis=0)]
            maps = pusher.step(z), pusher.smoothed(z, sigma), nearest
            others[row, column] = [_risk(joint, y, values) / smallest_risk - 1 for values in maps]
    dimensions = ("case", "width")
    return {
        "higher": (
            (*dimensions, "change", "perturbation"),
            higher,
            "m^2",
            "noised risk of g_sigma perturbed, above that of g_sigma",
        ),
        "risk": (dimensions, risk, "m^2", "noised risk of g_sigma"),
        "others": (
            (*dimensions, "candidate"),
            others,
            "1",
            "noised risk of other maps, above and over that of g_sigma",
        ),
    }


def _distribution(case: str, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return values of x in [-1, 1] m and their probabilities, for equally likely data or quadrature of a density."""
    if "data" in case:
        n = int(case.split()[0])
        # One datum lies in each of n equal parts of the interval, so that the pusher is in contact at some data.
        return 2 * (np.arange(n) + rng.uniform(size=n)) / n - 1, np.full(n, 1 / n)
    node, weight = np.polynomial.legendre.leggauss(100)
    # The interval is split at the kink of f.
    x, weight = np.append(node - 1, node + 1) / 2, np.tile(weight, 2)
    chance = weight * (1.2 + x if case == "a ramp" else np.exp(-0.5 * (x / 0.4) ** 2))
    return x, chance / chance.sum()


def _risk(joint: np.ndarray, y: np.ndarray, map_values: np.ndarray) -> float:
    """Return the noised risk ``E |g(z) - y|²``, Suh et al. 2023, eq. 3, for joint probabilities (n, k) of y and z."""
    return float(np.sum(joint * (map_values - y[:, None]) ** 2))


def score_error(seed: int, n: int = 300, queries: int = 50) -> dict[str, Any]:
    """Check ``g(z) = z + sigma² grad log p_sigma(z)`` for f(x) = x, by differences of log p.

    The truncation errors of central differences of fourth order with a step of 1e-3 sigma are about
    1e-11, as are the rounding errors.
    """
    rng, step = np.random.default_rng([seed, 2]), 1e-3
    errors = np.empty((len(DIMENSIONS), len(SPREADS)))
    for row, column in np.ndindex(errors.shape):
        dim, sigma = DIMENSIONS[row], float(SPREADS[column])
        x = rng.standard_normal((n, dim))
        names = tuple(Signal(f"x{i}", "1") for i in range(dim))
        scales = Normalisation(np.zeros(dim), np.ones(dim))
        model = EwdaModel(x, x, scales, sigma, DataOrigin(names, names))
        distance = sigma * rng.uniform(0, 5, (queries, 1))
        z = x[:queries] + distance * rng.standard_normal((queries, dim))
        log_densities = [[model.values(z + k * step * sigma * e)[:, -1] for k in (-2, -1, 1, 2)] for e in np.eye(dim)]
        slopes = np.einsum("k,ikq->qi", np.array([1, -8, 8, -1]) / (12 * step), np.array(log_densities))
        errors[row, column] = np.abs(model.values(z)[:, :-1] - z - sigma * slopes).max() / sigma
    return {"score_error": (("dimension", "spread"), errors, "1", "largest |g - z - sigma² grad log p| over sigma")}


DEPTHS = np.array([0.0, 0.1, 0.3, 1, 2, 3, 5, 10, 20, 50, 100, 1000])
"""Penetrations into a wall, in units of sigma."""
DISTANCES = np.linspace(0, 6, 121)
"""Distances from an end of the data towards their middle, in units of sigma."""
ENDS = ("upper", "lower")
"""Names of the two ends of the interval of uniform data."""
GAPS = np.array([0.5, 2.0, 8.0])
"""Distances between the walls [m]."""
SAMPLES = np.array([10, 100, 1000, 10000])
"""Numbers of random states between the walls."""
_STATES = 4000
"""Number of states between the walls at which maps are evaluated."""


def truncated_normal() -> dict[str, Any]:
    """Compare g_sigma of evenly spaced data between walls with the mean of a truncated normal.

    The error of the midpoint rule is ``D²/24`` times the change of the integrand's derivative between the
    ends. For the quotient g_sigma this gives, at each wall w with density k,

        D²/24 k(w)/mass (1 + (w - g)(x - w)/sigma²).
    """
    errors = np.empty((len(WIDTHS), len(SPACINGS)))
    law = np.empty_like(errors)
    block = Walls()
    for row, sigma in enumerate(WIDTHS):
        x = np.linspace(-1 - 4 * sigma, 1 + 4 * sigma, 801)
        g = block.noised(x, sigma)
        for column, spacing in enumerate(SPACINGS):
            count = round((block.high - block.low) / (spacing * sigma))
            data = block.low + (np.arange(count) + 0.5) * (block.high - block.low) / count
            errors[row, column] = np.abs(model_values(average_of(data, data, sigma), x) - g).max() / sigma
            law[row, column] = np.abs(_midpoint(block, x, g, sigma, data[1] - data[0])).max() / sigma
    return {
        "walls_error": (("width", "spacing"), errors, "1", "largest |g - closed form| over sigma, evenly spaced data"),
        "walls_law": (("width", "spacing"), law, "1", "the same by the error of the midpoint rule"),
        **_outside(),
        **_fixed_points(),
    }


def _midpoint(block: Walls, x: np.ndarray, g: np.ndarray, sigma: float, spacing: float) -> np.ndarray:
    edges = np.array([[block.low], [block.high]])
    low, high = norm.cdf(edges, x, sigma)
    change = norm.pdf(edges, x, sigma) / (high - low) * (1 + (edges - g) * (x - edges) / sigma**2)
    return spacing**2 / 24 * (change[1] - change[0])


def _outside() -> dict[str, Any]:
    """Compute, for penetrating states, the inward distance of g_sigma from the wall, and its slope."""
    inside, slope = np.empty((2, len(GAPS), len(WIDTHS), len(DEPTHS)))
    for row, gap in enumerate(GAPS):
        block = Walls(-gap / 2, gap / 2)
        for column, sigma in enumerate(WIDTHS):
            x = block.high + DEPTHS * sigma
            inside[row, column] = (block.high - block.noised(x, sigma)) / sigma
            slope[row, column] = block.slope(x, sigma)
    dimensions = ("gap", "width", "depth")
    return {
        "inside": (dimensions, inside, "1", "way inside the wall after a step, over sigma"),
        "slope_outside": (dimensions, slope, "1", "slope of g_sigma in penetration"),
    }


def _fixed_points() -> dict[str, Any]:
    """Compute the number of sign changes of g_sigma(x) - x, and the fraction of states that move towards a wall."""
    count, outwards = np.empty((2, len(GAPS), len(WIDTHS)))
    for index in np.ndindex(count.shape):
        gap, sigma = float(GAPS[index[0]]), float(WIDTHS[index[1]])
        block = Walls(-gap / 2, gap / 2)
        x = np.linspace(block.low, block.high, _STATES)
        direction = np.sign(block.displacement(x, sigma))
        # Deep between the walls the displacement underflows to 0, which has no sign.
        count[index] = np.count_nonzero(np.diff(direction[direction != 0]))
        outwards[index] = np.mean(direction * x > 0)
    dimensions = ("gap", "width")
    return {
        "fixed_points": (dimensions, count, "1", "changes of sign of g_sigma(x) - x"),
        "outwards": (dimensions, outwards, "1", "share of states that move outwards"),
    }


def climb_density(sigma: float, seed: int) -> dict[str, Any]:
    """Iterate g_sigma; return the end points and the smallest increase of log p_sigma in any step.

    The data of g_sigma are random states between two walls; p_sigma is their density with noise added.
    """
    x = np.linspace(-1, 1, _STATES)
    attractors, climb, centre = np.empty((3, len(SAMPLES)))
    for i, n in enumerate(SAMPLES):
        data = np.random.default_rng([seed, 3, i]).uniform(-1, 1, n)
        model = average_of(data, data, sigma)
        averages = model.values(x[:, None])
        displacement = averages[:, 0] - x
        turns = np.flatnonzero((displacement[:-1] > 0) & (displacement[1:] <= 0))
        attractors[i], centre[i] = turns.size, np.abs(x[turns]).max()
        climb[i] = (model.values(averages[:, :1])[:, 1] - averages[:, 1]).min()
    return {
        "attractors": ("sample", attractors, "1", "states at which rollouts end"),
        "off_centre": ("sample", centre, "m", "distance of the farthest from the middle"),
        "climb": ("sample", climb, "1", "least growth of log p_sigma in a step"),
    }


def near_the_ends(rho: float) -> dict[str, Any]:
    """Compute ``(g_sigma - f_sigma)/(rho sigma)`` at distances from both ends of data uniform on [-1, 1] m."""
    pusher, block = LinePusher(rho), Walls()
    bias = np.empty((len(ENDS), len(WIDTHS), len(DISTANCES)))
    for column, sigma in enumerate(WIDTHS):
        for row, end in enumerate((block.high, block.low)):
            u = end * (1 - DISTANCES * sigma)
            g = pusher.noised(u, sigma, block.low, block.high)
            bias[row, column] = (g - pusher.smoothed(u, sigma)) / (rho * sigma)
    return {
        "bias": (
            ("end", "width", "distance"),
            bias,
            "1",
            "(g_sigma - f_sigma)/(rho sigma) of uniform data near its ends",
        )
    }
