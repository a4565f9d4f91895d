"""T1: the papers' theorems on stiffness, variance and bias, tested on random contact problems."""

from __future__ import annotations

import numpy as np
import xarray as xr

from problems.studies.shared import contact_bounds as bounds
from problems.studies.study import StudyParams, dataset, setting

SIZES = tuple(range(1, 9))
"""Numbers of contacts of the random systems."""
MUS = 10.0 ** np.arange(-8, 1)
"""Central-path parameters of the sweep."""
GAINS = np.array([0.8, 1.0, 1.2])
"""Lipschitz constants of the dynamics for which the growth of the variance is checked."""
_DOMAIN_POINTS = 5
"""Number of points in each system's domain at which the largest slope and |z| for thm. 4.5 are taken."""
HORIZONS = np.array([2, 4, 6, 8, 10, 12, 14, 16, 18, 20])
"""Horizons [steps] for which the growth of the variance is checked."""
BOUNDS = (
    "4.5 as printed",
    "4.5, sign corrected",
    "4.5, l at the point",
    "1/lambda_min(S)",
    "5.1",
    "5.1 corrected",
    "A.26 for the slope",
)
"""Names of the bounds that are compared with the true slope."""

QUICK = {"draws": 50, "sweep": 4, "pairs": 15, "n_samples": 4000}


class Params(StudyParams):
    """Parameters of study T1; all defaults are our choice, since the papers test none of these theorems."""

    draws: int = setting(200, "1", "random systems for each size and kind", least=10)
    sweep: int = setting(20, "1", "systems of four contacts followed over mu", least=2)
    pairs: int = setting(60, "1", "random single contacts for prop. 5.2 to thm. 5.4", least=5)
    n_samples: int = setting(20000, "1", "samples behind each variance", least=100)


def _audit(params: Params, rng: np.random.Generator) -> dict:
    """Compute ratios of slope to bound (kind, size, bound, draw); a bound holds if its ratio is at most one."""
    shape = (len(bounds.KINDS), len(SIZES), len(BOUNDS), params.draws)
    ratio = np.full(shape, np.nan)
    step = np.zeros(shape[:2])
    for row, kind in enumerate(bounds.KINDS):
        for column, n in enumerate(SIZES):
            F = np.stack([bounds.random_p_matrix(rng, n, kind) for _ in range(params.draws)])
            mu = 10 ** rng.uniform(-8, 0, params.draws)
            z = rng.standard_normal((params.draws, n))
            any_z, away = bounds.solve_softened(z, F, mu), bounds.solve_softened(np.abs(z) + 0.05, F, mu)
            reach, steepest = _over_domain(z, F, mu, rng)
            gaps = np.abs(z) + 0.05
            slope, slope_away = bounds.spectral_norms(any_z.slope), bounds.spectral_norms(away.slope)
            wrong = bounds.spectral_norms(bounds.printed_a26(any_z.lam, any_z.gap, F) - any_z.slope)
            ratio[row, column] = [
                steepest / bounds.theorem_4_5(reach, F, mu, 1),
                steepest / bounds.theorem_4_5(reach, F, mu, -1),
                slope / bounds.pointwise_4_5(any_z.lam, mu),
                slope / bounds.definite_bound(F),
                slope_away / bounds.theorem_5_1(gaps, mu),
                slope_away / bounds.corrected_5_1(gaps, F, mu),
                wrong / np.maximum(slope, 1e-300),
            ]
            undefined = ~np.isfinite(bounds.definite_bound(F))
            for bound in (3, 5):
                ratio[row, column, bound, undefined] = np.nan
            step[row, column] = np.mean(np.any(away.lam > mu[:, None] / gaps, axis=1))
    return {
        "ratio": (("kind", "size", "bound", "draw"), ratio, "1", "true slope over bound; for A.26 its relative error"),
        "step_5_1": (("kind", "size"), step, "1", "how often lam_i > mu/z_i, against a step in the proof of 5.1"),
    }


def _over_domain(
    z: np.ndarray, F: np.ndarray, mu: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Return the largest |z| and the largest slope of every system over its domain, (draws,) each."""
    reach, steepest = np.linalg.norm(z, axis=1), bounds.spectral_norms(bounds.solve_softened(z, F, mu).slope)
    for _ in range(_DOMAIN_POINTS - 1):
        direction = rng.standard_normal(z.shape)
        reach = np.maximum(reach, np.linalg.norm(direction, axis=1))
        steepest = np.maximum(steepest, bounds.spectral_norms(bounds.solve_softened(direction, F, mu).slope))
    return reach, steepest


def _sweep(params: Params, rng: np.random.Generator, n: int = 4) -> dict:
    """Compute largest slope, largest curvature at a kink and printed bound for each (kind, mu)."""
    slope, curvature, bound = np.empty((3, len(bounds.KINDS), len(MUS)))
    for row, kind in enumerate(bounds.KINDS):
        F = np.stack([bounds.random_p_matrix(rng, n, kind) for _ in range(params.sweep)])
        open_, shut = np.exp(rng.standard_normal((2, params.sweep, n)))
        for column, mu in enumerate(MUS):
            # Contact 0 is at its kink, contact 1 is closed, and the others are open.
            lam, gap = mu / open_, open_.copy()
            lam[:, 1], gap[:, 1] = shut[:, 1], mu / shut[:, 1]
            lam[:, 0] = gap[:, 0] = np.sqrt(mu)
            z = gap - np.einsum("kij,kj->ki", F, lam)
            weights = np.full(params.sweep, mu)
            delta = np.zeros((1, n))
            delta[0, 0] = 1e-3 * np.sqrt(mu)
            centre, up, down = (bounds.solve_softened(z + d, F, weights) for d in (0 * delta, delta, -delta))
            slope[row, column] = bounds.spectral_norms(centre.slope).max()
            second_difference = bounds.spectral_norms(up.slope - down.slope) / (2 * delta[0, 0])
            curvature[row, column] = second_difference.max()
            reach = np.linalg.norm(z, axis=1)
            bound[row, column] = bounds.theorem_4_5(reach, F, weights, 1).max()
    dimensions = ("kind", "mu")
    return {
        "slope": (dimensions, slope, "1", "largest |dlam/dz| of all systems"),
        "curvature": (dimensions, curvature, "1", "largest |d²lam/dz²| at a kink"),
        "printed": (dimensions, bound, "1", "bound of thm. 4.5 as printed"),
    }


def _counterexamples() -> dict:
    """Evaluate two systems that violate the bounds of thm. 4.5 and thm. 5.1."""
    F = np.array([[[1.0, -1000.0], [0.0, 1.0]], [[1.0, -100.0], [0.0, 1.0]]])
    z, mu = np.array([[1000.0, 0.0], [1.0, 1.0]]), np.ones(2)
    softened = bounds.solve_softened(z, F, mu)
    # For C = [1, 0], D = [0, 1]' there is one state, n² |C| |D| = 4, and l mu = |diag(lam)|².
    state = abs(softened.slope[0, 0, 1])
    bound = 4 * float(np.sum(softened.lam[0] ** 2))
    return {
        "counter_4_5": ("side", [state, bound], "1", "|dx+/dx| and thm. 4.5 at F_1"),
        "counter_5_1": (
            "side",
            [bounds.spectral_norms(softened.slope)[1], bounds.theorem_5_1(z[1:], mu[1:])[0]],
            "1",
            "|dlam/dz| and thm. 5.1 at F_2",
        ),
    }


def run(params: Params) -> xr.Dataset:
    """Compute the data of all checks of the theorems."""
    rng = np.random.default_rng(params.seed)
    audit, sweep = _audit(params, rng), _sweep(params, rng)
    pairs = bounds.smoothing_pairs(rng, params.pairs)
    bias = bounds.theorem_5_4(rng, params.pairs)
    vectors = bounds.empirical_bias_pairs(rng, 100 * params.draws)
    unbiased = bounds.compare_orders(params.seed, 10 * params.n_samples)
    growth = bounds.variance_growth(params.seed, params.n_samples, HORIZONS, GAINS)
    return dataset(
        {
            **audit,
            **sweep,
            **_counterexamples(),
            **{f"pair_{name}": ("pair", values, "1", f"{name}, single contact") for name, values in pairs.items()},
            **{f"vector_{name}": ("vector", values, "1", f"{name}, lemma III.4") for name, values in vectors.items()},
            **{
                f"printed_{name}": (("constants", "pair"), values, "1", f"{name} of thm. 5.4, eq. 5.1 as printed")
                for name, values in bias.items()
            },
            "z_score": ((), unbiased["z_score"], "1", "lemma III.1 on wall-1d"),
            "components": ((), unbiased["components"], "1", "inputs compared"),
            "growth": (("gain", "horizon"), growth, "1", "variance of the gradient"),
            "policy_lipschitz": (
                (),
                np.hypot(1, bounds.GROWTH_NOISE),
                "1",
                "constant of the policy in state and noise",
            ),
        },
        {
            "kind": list(bounds.KINDS),
            "size": (SIZES, "1", "number of contacts"),
            "bound": list(BOUNDS),
            "constants": [f"({a:g}, {b:g})" for a, b in bounds.CONSTANTS],
            "mu": (MUS, "1", "central-path parameter"),
            "gain": (GAINS, "1", "Lipschitz constant of the dynamics"),
            "horizon": (HORIZONS, "1", "steps"),
        },
    )
