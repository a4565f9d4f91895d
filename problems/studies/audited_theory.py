"""T1: the papers' theorems on stiffness, variance and bias, tested on random contact problems."""

from __future__ import annotations

import numpy as np
import xarray as xr

from problems.studies.shared import contact_bounds as bounds
from problems.studies.study import Claim, StudyParams, claim, dataset, format_values, setting, settings_text

NOTES = (
    "Systems: C = D = I, A = B = E = 0, where the bounds are tightest; z standard normal,"
    " mu log-uniform from 1e-8 to 1; F symmetric positive definite, or a P-matrix that is"
    " neither symmetric nor definite. All numbers are without units.",
    "Thm. 4.5 puts a lower bound on l inside an upper bound on the slope, which bounds"
    " nothing; taken as an equality, it is the printed formula, and its sign (A.32) is wrong.",
    "dlam/dz = -(I - D + D F)^-1 D with D in [0, 1]: for a P-matrix the slope is bounded"
    " whatever mu. What grows as mu falls is the curvature, 1/(4 F^1.5 sqrt(mu)).",
)


SIZES = tuple(range(1, 9))
"""Numbers of contacts of the random systems."""
MUS = 10.0 ** np.arange(-8, 1)
"""Central-path parameters of the sweep."""
GAINS = np.array([0.8, 1.0, 1.2])
"""Lipschitz constants of the dynamics in the growth of variance."""
_DOMAIN_POINTS = 5
"""Points of each system's domain over which slope and supremum of thm. 4.5 are taken."""
HORIZONS = np.array([2, 4, 6, 8, 10, 12, 14, 16, 18, 20])
"""Horizons of the growth of variance [steps]."""
BOUNDS = (
    "4.5 as printed",
    "4.5, sign corrected",
    "4.5, l at the point",
    "1/lambda_min(S)",
    "5.1",
    "5.1 corrected",
    "A.26 for the slope",
)
"""Bounds whose ratio to the true slope is audited."""

QUICK = {"draws": 50, "sweep": 4, "pairs": 15, "n_samples": 4000}


class Params(StudyParams):
    """Parameters of T1, all our choice: the papers test none of these theorems."""

    draws: int = setting(200, "1", "random systems for each size and kind", least=10)
    sweep: int = setting(20, "1", "systems of four contacts followed over mu", least=2)
    pairs: int = setting(60, "1", "random single contacts for prop. 5.2 to thm. 5.4", least=5)
    n_samples: int = setting(20000, "1", "samples behind each variance", least=100)


def _audit(params: Params, rng: np.random.Generator) -> dict:
    """Compute slope over bound, (kind, size, bound, draw): a bound holds where this is at most one."""
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
            apart = np.abs(z) + 0.05
            slope, slope_away = bounds.spectral_norms(any_z.slope), bounds.spectral_norms(away.slope)
            wrong = bounds.spectral_norms(bounds.printed_a26(any_z.lam, any_z.gap, F) - any_z.slope)
            ratio[row, column] = [
                steepest / bounds.theorem_4_5(reach, F, mu, 1),
                steepest / bounds.theorem_4_5(reach, F, mu, -1),
                slope / bounds.pointwise_4_5(any_z.lam, mu),
                slope / bounds.definite_bound(F),
                slope_away / bounds.theorem_5_1(apart, mu),
                slope_away / bounds.corrected_5_1(apart, F, mu),
                wrong / np.maximum(slope, 1e-300),
            ]
            undefined = ~np.isfinite(bounds.definite_bound(F))
            for bound in (3, 5):
                ratio[row, column, bound, undefined] = np.nan
            step[row, column] = np.mean(np.any(away.lam > mu[:, None] / apart, axis=1))
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
        other = rng.standard_normal(z.shape)
        reach = np.maximum(reach, np.linalg.norm(other, axis=1))
        steepest = np.maximum(steepest, bounds.spectral_norms(bounds.solve_softened(other, F, mu).slope))
    return reach, steepest


def _sweep(params: Params, rng: np.random.Generator, n: int = 4) -> dict:
    """Compute the largest slope, curvature at a kink and printed bound over mu, (kind, mu)."""
    slope, curvature, bound = np.empty((3, len(bounds.KINDS), len(MUS)))
    for row, kind in enumerate(bounds.KINDS):
        F = np.stack([bounds.random_p_matrix(rng, n, kind) for _ in range(params.sweep)])
        open_, shut = np.exp(rng.standard_normal((2, params.sweep, n)))
        for column, mu in enumerate(MUS):
            # Contact 0 at its kink, contact 1 pressed, the others open.
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
    """Evaluate the two systems of the errata that break the final inequalities."""
    F = np.array([[[1.0, -1000.0], [0.0, 1.0]], [[1.0, -100.0], [0.0, 1.0]]])
    z, mu = np.array([[1000.0, 0.0], [1.0, 1.0]]), np.ones(2)
    softened = bounds.solve_softened(z, F, mu)
    # C = [1, 0], D = [0, 1]': one state, n² |C| |D| = 4, and |diag(lam)|² for l mu.
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
    """Run all checks; each claim says what its check is for."""
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


def claims(data: xr.Dataset) -> list[Claim]:
    """Return a claim for each theorem, and for one that fails its corrected form too."""
    return [
        *_stiffness(data),
        *_near_contact(data),
        *_smoothing(data),
        *_bias(data),
        *_estimators(data),
        *_growth(data),
    ]


def _holds(data: xr.Dataset, bound: str) -> tuple[float, float, str]:
    """Return the share of symmetric and of P-matrices for which a bound holds, and both as a text."""
    share = []
    for kind in data["kind"].values:
        ratio = data["ratio"].sel(bound=bound, kind=kind).values
        finite = np.isfinite(ratio)
        share.append(float(np.mean(ratio[finite] <= 1 + 1e-9)) if finite.any() else np.nan)
    return share[0], share[1], f"holds in {share[0]:.1%} symmetric, {share[1]:.1%} P"


def _slope(x: np.ndarray, y: np.ndarray) -> float:
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])


def _stiffness(data: xr.Dataset) -> list[Claim]:
    mu = data["mu"].values
    stiff = mu < 1e-2
    power = [_slope(mu[stiff], data["slope"].values[k][stiff]) for k in (0, 1)]
    bend = [_slope(mu[stiff], data["curvature"].values[k][stiff]) for k in (0, 1)]
    printed = _holds(data, "4.5 as printed")
    signed = _holds(data, "4.5, sign corrected")
    point = _holds(data, "4.5, l at the point")
    definite = _holds(data, "1/lambda_min(S)")
    counter_slope, counter_bound = data["counter_4_5"].values
    return [
        claim("The Lipschitz constant explodes as mu falls, inversely proportional to it", "ABS, sec. 4.3")
        .expected("slope ~ mu^-1")
        .measured(f"slope ~ mu^{power[0]:.3f} symmetric, mu^{power[1]:.3f} P")
        .below(power, -0.5),
        claim("What grows as mu falls is curvature", "corrected, 1/(4 F^1.5 sqrt(mu))")
        .expected("curvature ~ mu^-0.5")
        .measured(f"mu^{bend[0]:.3f} symmetric, mu^{bend[1]:.3f} P")
        .holds(np.allclose(bend, -0.5, atol=0.05)),
        claim("The slope is within the bound with l(mu) as printed", "ABS, thm. 4.5")
        .expected("always, l at its lower bound")
        .measured(printed[2] + ", largest slope and supremum over several points of each")
        .equals(min(printed[:2]), 1),
        claim("The same with the sign of (A.32) right", "ABS, thm. 4.5, (A.32)")
        .expected("always")
        .measured(signed[2])
        .equals(min(signed[:2]), 1),
        claim("The same with l = |diag(lam)|²/mu at the point", "ABS, proof of thm. 4.5")
        .expected("always, F = [[1, -1000], [0, 1]] too")
        .measured(f"{point[2]}; there the slope is {counter_slope:.0f}, the bound {counter_bound:.0f}")
        .holds(min(point[:2]) == 1, counter_slope <= counter_bound),
        claim("|dlam/dz| <= 1/lambda_min(S) where S = sym(F) is definite", "corrected")
        .expected("always")
        .measured(definite[2])
        .equals(min(definite[:2]), 1),
    ]


def _near_contact(data: xr.Dataset) -> list[Claim]:
    final, corrected = _holds(data, "5.1"), _holds(data, "5.1 corrected")
    size = data["size"].values
    step = data["step_5_1"].values[:, 1:]
    slope, bound = data["counter_5_1"].values
    error = data["ratio"].sel(bound="A.26 for the slope").median("draw").values
    return [
        claim("The slope away from contact is within the bound", "ABS, thm. 5.1")
        .expected("always, F = [[1, -100], [0, 1]] at z = (1, 1) too")
        .measured(f"{final[2]}; there the slope is {slope:.1f}, the bound {bound:.0f}")
        .holds(min(final[:2]) == 1, slope <= bound),
        claim("There lam_i <= mu/z_i", "ABS, proof of thm. 5.1")
        .expected("never violated")
        .measured(f"violated in {step.min():.0%} to {step.max():.0%} of systems with {size[1]} to {size[-1]} contacts")
        .equals(step.max(), 0),
        claim("|dlam/dz| <= min(1/lambda_min(S), n² mu/min z²), S definite", "corrected")
        .expected("always")
        .measured(corrected[2])
        .equals(min(corrected[:2]), 1),
        claim("dlam/dz couples no contacts", "ABS, eq. A.26")
        .expected("no error")
        .measured(
            f"median error {error[0, 1]:.0%} at {size[1]} contacts, {error[0, -1]:.0%} at"
            f" {size[-1]} (symmetric); {error[1, 1]:.0%}, {error[1, -1]:.0%} (P)"
        )
        .below(error[:, 1:], 1e-6),
    ]


def _smoothing(data: xr.Dataset) -> list[Claim]:
    pair = {str(name)[5:]: data[name].values for name in data if str(name).startswith("pair_")}
    barrier, gaussian = np.abs(pair["barrier"]).max(), np.abs(pair["gaussian"]).max()
    mass, misfits = pair["mass"], pair["misfit"]
    return [
        claim("S_mu(z) = E S_0(z + w) for the noise of constant mu", "ABS, prop. 5.2")
        .expected("0")
        .measured(f"{barrier:.0e}")
        .below(barrier, 1e-8),
        claim("The density of that noise is S_mu''", "ABS, prop. 5.2")
        .expected("integral 1")
        .measured(
            f"{mass.min():.3f} to {mass.max():.3f}; times F {(mass * pair['F']).min():.3f} to"
            f" {(mass * pair['F']).max():.3f}"
        )
        .holds(np.allclose(mass, 1, atol=0.01)),
        claim("kappa as printed is E S_0(z + w), w Gaussian", "ABS, prop. 5.3, eq. 5.1")
        .expected("equal over z at some c1, c2")
        .measured(
            f"within a hundredth of sigma/F in {np.mean(misfits < 0.01):.0%} of {misfits.size} cases,"
            f" off by {misfits.min():.2g} to {misfits.max():.2g} sigma/F at the best constants"
        )
        .below(misfits, 0.01),
        claim("kappa corrected is", "eq. 5.1 corrected")
        .expected("equal")
        .measured(f"{gaussian:.0e}")
        .below(gaussian, 1e-8),
    ]


def _bias(data: xr.Dataset) -> list[Claim]:
    bias, bound = data["printed_bias"].values, data["printed_bound"].values
    constants = [str(c) for c in data["constants"].values]
    is_bounded = bias <= bound
    everywhere, solved = is_bounded.mean(axis=1), np.isfinite(bias)
    above = np.mean(solved & ~is_bounded, axis=1)
    largest_error = np.abs(data["pair_bias"].values - data["pair_tail"].values).max()
    return [
        claim("The bias of the adaptive slope is within its bound", "ABS, thm. 5.4")
        .expected("always, with mu of prop. 5.3 as printed, at constants (c1, c2)")
        .measured(
            f"constants {settings_text(constants, everywhere == 1)}: holds in "
            + format_values(everywhere, ".0%")
            + " of cases; above it in "
            + format_values(above, ".0%")
            + ", in the rest mu is negative and"
            " there is no softened model"
        )
        .holds(is_bounded),
        claim("With the corrected mu that bias is tail(|z|/sigma)/F", "corrected")
        .expected("equal, so at most 1/(2F)")
        .measured(f"within {largest_error:.0e}/F; largest {data['pair_bias'].values.max():.3f}/F")
        .below(largest_error, 1e-9),
    ]


def _estimators(data: xr.Dataset) -> list[Claim]:
    variance, paper, sharp = (data[f"vector_{name}"].values for name in ("variance", "paper", "sharp"))
    shares = [float(np.mean(variance >= bound * (1 - 1e-9) - 1e-9)) for bound in (paper, sharp)]
    score = float(data["z_score"])
    return [
        claim("First-order gradients are unbiased where the step is Lipschitz", "Pathologies, lemma III.1")
        .expected("means equal")
        .measured(
            f"largest of {int(data['components'])} differences is {score:.1f} standard errors (problem wall, exact law)"
        )
        .below(score, 5),
        claim("Var z >= Delta_0²/beta", "Pathologies, lemma III.4")
        .expected("always")
        .measured(f"holds in {shares[0]:.2%} of {variance.size} random vectors, is zero in {np.mean(paper == 0):.0%}")
        .equals(shares[0], 1),
        claim("Var z >= (1 - beta)/beta Delta²", "lemma III.4 sharpened")
        .expected("always")
        .measured(f"holds in {shares[1]:.2%}")
        .equals(shares[1], 1),
    ]


def _growth(data: xr.Dataset) -> list[Claim]:
    """Compare the exponential rate of variance/H⁴ at long horizons with both theorems."""
    horizon, gains = data["horizon"].values, data["gain"].values
    late = horizon >= np.median(horizon)
    scaled = np.log(data["growth"].values / horizon**4.0)
    rate = np.array([np.polyfit(horizon[late], row[late], 1)[0] for row in scaled])
    raw = rate + np.polyfit(horizon[late], 4 * np.log(horizon[late]), 1)[0]
    printed = 4 * np.log(np.maximum(gains, 1) * float(data["policy_lipschitz"]))
    right = printed + 4 * np.log(np.sqrt(2))

    measured = f"{format_values(rate, '.2f')} a step; of the variance itself {format_values(raw, '.2f')}"
    return [
        claim("The variance is O(H^4 (L_f L_pi)^4H)", "ABS, thm. 4.4")
        .expected(f"over H^4 rates at most {format_values(printed, '.2f')}")
        .measured(f"L_f {settings_text(list(gains), rate <= printed + 0.02)}: {measured}")
        .at_most(rate, printed + 0.02),
        claim("It is O(H^4 (sqrt(2) L_f L_pi)^4H)", "thm. 4.4 corrected")
        .expected(f"over H^4 rates at most {format_values(right, '.2f')}")
        .measured(f"L_f {settings_text(list(gains), rate <= right + 0.02)}: {measured}")
        .at_most(rate, right + 0.02),
    ]
