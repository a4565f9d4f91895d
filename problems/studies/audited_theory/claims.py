"""Claims of T1 on the papers' theorems on stiffness, smoothing, bias and variance."""

from __future__ import annotations

import numpy as np
import xarray as xr

from problems.studies.study import Claim, claim, format_values, settings_text


def claims(data: xr.Dataset) -> list[Claim]:
    """Return a claim for each theorem and, if the theorem fails, a second claim for its corrected form."""
    return [
        *_stiffness(data),
        *_near_contact(data),
        *_smoothing(data),
        *_bias(data),
        *_estimators(data),
        *_growth(data),
    ]


def _holds(data: xr.Dataset, bound: str) -> tuple[float, float, str]:
    """Return the fractions of symmetric matrices and of P-matrices for which a bound holds, and a text with both."""
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
    """Compare the growth rate of variance/H⁴ at long horizons H with theorem 4.4 as printed and as corrected."""
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
