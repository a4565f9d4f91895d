"""What T1's data say of each theorem."""

from __future__ import annotations

import numpy as np
import xarray as xr

from problems.studies.study import Claim


def claims(data: xr.Dataset) -> list[Claim]:
    """One claim a theorem, and for those that fail the corrected form beside it."""
    return [*_stiffness(data), *_near_contact(data), *_smoothing(data), *_estimators(data)]


def _holds(data: xr.Dataset, bound: str) -> tuple[float, float, str]:
    """How often a bound holds, for symmetric and for P-matrices, and both as a text."""
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
    slope, held = data["counter_4_5"].values
    return [
        Claim("The Lipschitz constant is at least inversely proportional to mu",
              "ABS, thm. 4.5", "slope ~ mu^-1", f"slope ~ mu^{power[0]:.3f} symmetric,"
              f" mu^{power[1]:.3f} P", bool(max(power) < -0.5)),
        Claim("What grows as mu falls is curvature", "corrected, 1/(4 F^1.5 sqrt(mu))",
              "curvature ~ mu^-0.5", f"mu^{bend[0]:.3f} symmetric, mu^{bend[1]:.3f} P",
              bool(np.allclose(bend, -0.5, atol=0.05))),
        Claim("The slope is within the bound with l(mu) as printed", "ABS, thm. 4.5",
              "always", printed[2], min(printed[:2]) == 1),
        Claim("The same with the sign of (A.32) right", "ABS, thm. 4.5, (A.32)",
              "always", signed[2], min(signed[:2]) == 1),
        Claim("The same with l = |diag(lam)|²/mu at the point", "ABS, proof of thm. 4.5",
              "always", f"{point[2]}; but F = [[1, -1000], [0, 1]]: slope {slope:.0f} >"
              f" {held:.0f}", bool(min(point[:2]) == 1 and slope <= held)),
        Claim("|dlam/dz| <= 1/lambda_min(S) where S = sym(F) is definite", "corrected",
              "always", definite[2], min(definite[:2]) == 1),
    ]  # fmt: skip


def _near_contact(data: xr.Dataset) -> list[Claim]:
    final, corrected = _holds(data, "5.1"), _holds(data, "5.1 corrected")
    step = data["step_5_1"].values[:, 1:]
    slope, bound = data["counter_5_1"].values
    error = data["ratio"].sel(bound="A.26 for the slope").median("draw").values
    return [
        Claim("The slope away from contact is within the bound", "ABS, thm. 5.1", "always",
              f"{final[2]}; but F = [[1, -100], [0, 1]], z = (1, 1): {slope:.1f} > {bound:.0f}",
              bool(min(final[:2]) == 1 and slope <= bound)),
        Claim("There lam_i <= mu/z_i", "ABS, proof of thm. 5.1", "never violated",
              f"violated in {step.min():.0%} to {step.max():.0%} of systems with 2 to 8 contacts",
              bool(step.max() == 0)),
        Claim("|dlam/dz| <= min(1/lambda_min(S), n² mu/min z²), S definite", "corrected",
              "always", corrected[2], min(corrected[:2]) == 1),
        Claim("dlam/dz couples no contacts", "ABS, eq. A.26", "no error",
              f"median error {error[0, 1]:.0%} at 2 contacts, {error[0, -1]:.0%} at 8 (symmetric);"
              f" {error[1, 1]:.0%}, {error[1, -1]:.0%} (P)", bool(error[:, 1:].max() < 1e-6)),
    ]  # fmt: skip


def _smoothing(data: xr.Dataset) -> list[Claim]:
    pair = {str(name)[5:]: data[name].values for name in data if str(name).startswith("pair_")}
    barrier, gaussian = np.abs(pair["barrier"]).max(), np.abs(pair["gaussian"]).max()
    off = np.abs(pair["printed"] / pair["true"] - 1)
    worst = np.max(pair["bias"] * pair["F"])
    loose = pair["bound"] / np.maximum(pair["bias"], 1e-300)
    return [
        Claim("S_mu(z) = E S_0(z + w) for the noise of constant mu", "ABS, prop. 5.2", "0",
              f"{barrier:.0e}", bool(barrier < 1e-8)),
        Claim("The density of that noise is S_mu''", "ABS, prop. 5.2", "integral 1",
              f"{pair['mass'].min():.3f} to {pair['mass'].max():.3f}: 1/F",
              bool(np.allclose(pair["mass"], 1, atol=1e-2))),
        Claim("kappa as printed is E S_0(z + w), w Gaussian", "ABS, eq. 5.1", "equal",
              f"within 1 % in {np.mean(off < 0.01):.0%} of {off.size} cases",
              bool(np.all(off < 0.01))),
        Claim("kappa corrected is", "eq. 5.1 corrected", "equal", f"{gaussian:.0e}",
              bool(gaussian < 1e-8)),
        Claim("The bias of the adaptive slope is within its bound", "ABS, thm. 5.4", "always",
              f"holds in {np.mean(loose >= 1):.0%}, {np.min(loose):.0f} times too large at best",
              bool(np.all(loose >= 1))),
        Claim("That bias is tail(|z|/sigma)/F, at most 1/(2F)", "corrected", "<= 0.5",
              f"bias F up to {worst:.3f}", bool(worst <= 0.5 + 1e-12)),
    ]  # fmt: skip


def _estimators(data: xr.Dataset) -> list[Claim]:
    variance, paper, sharp = (
        data[f"vector_{name}"].values for name in ("variance", "paper", "sharp")
    )
    good = [float(np.mean(variance >= bound * (1 - 1e-9) - 1e-9)) for bound in (paper, sharp)]
    score = float(data["z_score"])
    horizon = data["horizon"].values
    rate = [np.polyfit(horizon[4:], np.log(row[4:]), 1)[0] for row in data["growth"].values]
    gains = data["gain"].values
    unit = int(np.abs(gains - 1).argmin())
    ceiling = 4 * np.log(np.sqrt(2) * np.maximum(gains, 1))
    return [
        Claim("First-order gradients are unbiased where the step is Lipschitz",
              "Pathologies, lemma III.1", "means equal",
              f"largest of {int(data['components'])} differences is {score:.1f} standard errors"
              " (wall-1d, exact law)", score < 4),
        Claim("Var z >= Delta_0²/beta", "Pathologies, lemma III.4", "always",
              f"holds in {good[0]:.2%} of {variance.size} random vectors, is zero in"
              f" {np.mean(paper == 0):.0%}", good[0] == 1),
        Claim("Var z >= (1 - beta)/beta Delta²", "lemma III.4 sharpened", "always",
              f"holds in {good[1]:.2%}", good[1] == 1),
        Claim("With L_f = L_pi = 1 the variance grows as a polynomial of H", "ABS, thm. 4.4",
              "growth rate 0 per step", f"{rate[unit]:.3f} = 4 log sqrt(2) per step",
              bool(rate[unit] < 0.3)),
        Claim("The variance is O(H^4 (sqrt(2) L_f L_pi)^4H)", "thm. 4.4 corrected",
              "rates at most " + ", ".join(f"{c:.2f}" for c in ceiling),
              ", ".join(f"{r:.2f}" for r in rate) + " at L_f = "
              + ", ".join(f"{g:g}" for g in gains), bool(np.all(rate <= ceiling + 0.1))),
    ]  # fmt: skip
