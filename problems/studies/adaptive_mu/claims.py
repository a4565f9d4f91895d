"""What A1's data say of fig. 1 (c, d) and of prop. 5.2, 5.3."""

from __future__ import annotations

import numpy as np
import xarray as xr

from problems.studies.study import Claim, listed, over

_FAR = 3.0
"""Gap over sigma from which a contact is far."""


def claims(data: xr.Dataset) -> list[Claim]:
    """What fig. 1 (c, d) and prop. 5.2, 5.3 say, in their order."""
    return [*_tradeoff(data), *_smoothing(data), *_printed(data), *_lines(data)]


def _tradeoff(data: xr.Dataset) -> list[Claim]:
    F, sigma, gap = data.attrs["F"], data.attrs["sigma"], data["gap"].values
    far, width = gap >= _FAR, data["width"].values
    mu = data["gap_mu"].values
    share, peak = mu / mu[0], sigma**2 / (2 * np.pi * F)
    bend = data["bend"].values
    smoother = bend[0] < bend[1]
    adaptive, constant = data["gap_error"].values
    better = np.all(adaptive < constant, axis=0)[1:]
    reach = f"sigma = {width[0]:g} to {width[-1]:g} sqrt(F mu)"
    shares = listed(share[1:], ".2g")
    return [
        Claim("mu(z) is contact-aware: large only near z = 0", "ABS, fig. 1c",
              f"falls from sigma²/(2 pi F) = {peak:.4g}, below 1 % from {_FAR:g} sigma on",
              f"{mu[0]:.4g} at contact, {shares} of it at " + listed(gap[1:], "g") + " sigma",
              bool(np.isclose(mu[0], peak) and np.all(np.diff(mu) < 0)
                   and np.all(share[far] < 0.01))),
        Claim("mu(z) gives smoother dynamics than mu <= 0.1 around z = 0", "ABS, fig. 1d",
              f"less curvature at {reach}", f"{over(list(width), smoother)} sqrt(F mu)",
              bool(np.all(smoother))),
        Claim("mu(z) best approximates the exact solution in contact-free regions",
              "ABS, fig. 1d", f"error below that of mu = 0.1 from {_FAR:g} sigma on, at {reach}",
              f"{over(list(gap[1:]), better)} sigma", bool(np.all(better[far[1:]]))),
    ]  # fmt: skip


def _smoothing(data: xr.Dataset) -> list[Claim]:
    compliance = list(data["compliance"].values)
    mismatch, variance = data["mismatch"].values, data["variance_within"].values
    apart = np.abs(data["density_constant"].values / data["student"].values - 1).max()
    mass, slope = data["printed_mass"].values, data["quartic_slope"].values
    whole, monotone = np.abs(mass - 1) < 1e-2, slope <= 0
    reach = listed(data["reach"].values, "g")
    grown = listed(variance, ".2f")
    return [
        Claim("Constant mu is randomized smoothing by some noise", "ABS, prop. 5.2",
              "E S_0(z + w) = S_mu(z)", f"within {mismatch[:-1].max():.1e} of its size; density"
              f" equals Student's, two degrees of freedom, within {apart:.1e}",
              bool(mismatch[:-1].max() < 1e-9 and apart < 1e-6)),
        Claim("The noise has density rho = S_mu''(w)", "ABS, prop. 5.2",
              "integral 1", f"{over(compliance, whole)} m/(N s): integrals "
              + listed(mass, ".3f") + ", times F " + listed(mass * compliance, ".3f"),
              bool(np.all(whole))),
        Claim("The noise of constant mu has a variance", "our check",
              "finite variance", f"{grown} times its scale squared within {reach} scales",
              bool(np.diff(variance)[-1] < 0.01 * variance[0])),
        Claim("BS is RS for any mu(z)", "ABS, prop. 5.2",
              "dlam/dz <= 0 for eq. C.2, no negative density",
              f"{over(compliance, monotone)} m/(N s): slopes up to "
              + listed(slope, "+.3f") + " N s/m", bool(np.all(monotone))),
        Claim("The adaptive mu is Gaussian smoothing", "eq. 5.1 corrected",
              "E S_0(z + w) = S_mu(z)", f"within {mismatch[-1]:.1e} of its size",
              bool(mismatch[-1] < 1e-9)),
    ]  # fmt: skip


def _printed(data: xr.Dataset) -> list[Claim]:
    settings = [str(s) for s in data["setting"].values]
    found = []
    for reading, sentence, source in (
        (
            "the tail as printed",
            "kappa as printed is the Gaussian-smoothed solution",
            "ABS, eq. 5.1",
        ),
        (
            "the ordinary one",
            "It is with the ordinary error function for erf",
            "eq. 5.1 read otherwise",
        ),
    ):
        off = data["kappa_misfit"].sel(reading=reading).values
        good = off < 1e-6
        found.append(
            Claim(sentence, source, "equal at some c1, c2",
                  f"(F, variance) {over(settings, good)}; off by {off.min():.2g} to"
                  f" {off.max():.2g} sigma/F at the best constants", bool(np.all(good)))
        )  # fmt: skip
    return found


def _lines(data: xr.Dataset) -> list[Claim]:
    found, tangent = [], data["line"].values
    for norm, source in (("absolute", "ABS, prop. 5.3"), ("squared", "ABS, lemma A.4")):
        line = data["best_line"].sel(norm=norm).values
        off = np.abs(line - tangent).max(axis=0)
        found.append(
            Claim(f"K*, W* of the least {norm} residual are S_mu and its gradient", source,
                  "equal at gaps of -1, -1/2, 1/2 and 1 sigma",
                  f"off by up to {off[0]:.1e} sigma/F and {off[1]:.1e}/F",
                  bool(np.all(off < 2e-3)))
        )  # fmt: skip
    return found
