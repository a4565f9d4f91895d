"""A1: mu(z) and lam(z) of one contact, and the noise that each softening stands for."""

from __future__ import annotations

import numpy as np
import xarray as xr
from scipy.integrate import quad

from dynamics.contact import Adaptive, Barrier, Exact
from problems.spec import Citation
from problems.studies.noise import averaged_exact, gaussian, linearisations, printed_kappa, student
from problems.studies.scalar_contact import scalar_contact
from problems.studies.study import CHOICE, Claim, Study, StudyParams, quantity_of, setting

MUS = (0.01, 0.1, 1.0)
_F_OTHER = 2.5
"""A compliance other than 1, at which a missing factor F shows."""


class Params(StudyParams):
    """Parameters of A1; of the values, the paper's caption implies mu = 0.1 alone."""

    F: float = setting(1.0, "m/(N s)", "compliance of the contact", CHOICE, above=0)
    sigma: float = setting(1.0, "m", "standard deviation matched by mu(z)", CHOICE, above=0)
    z_max: float = setting(4.0, "m", "largest gap drawn", CHOICE, above=0)
    points: int = setting(400, "1", "gaps drawn, an even number", CHOICE, least=6)
    far: float = setting(3.0, "1", "contact-free is a gap of this many sigma", CHOICE, above=0)


def run(params: Params) -> xr.Dataset:
    """Curves under the exact law, three constant mu and the adaptive law; checks beside them."""
    F, sigma = params.F, params.sigma
    z = np.linspace(-params.z_max, params.z_max, params.points)
    constant = [scalar_contact(Barrier(mu=mu), z, F) for mu in MUS]
    adaptive = scalar_contact(Adaptive(sigma=sigma), z, F)
    quartic = scalar_contact(Adaptive(law="quartic-per-contact"), np.linspace(-1, 1, 2001), F)
    wide = np.concatenate((-np.geomspace(1e6, 1e-6, 40001), np.geomspace(1e-6, 1e6, 40001)))
    other = scalar_contact(Barrier(mu=0.1), wide, _F_OTHER)
    probes = np.linspace(-2, 2, 9) * sigma
    heavy = [student(F, mu) for mu in MUS]
    soft = [*(scalar_contact(Barrier(mu=mu), probes, F) for mu in MUS),
            scalar_contact(Adaptive(sigma=sigma), probes, F)]  # fmt: skip
    noise = [*heavy, gaussian(sigma)]
    mismatch = [
        max(abs(averaged_exact(at, F, w) - lam) for at, lam in zip(probes, s.lam, strict=True))
        for s, w in zip(soft, noise, strict=True)
    ]
    reach = np.array([10.0, 100.0, 1000.0, 10000.0])
    variance = [2 * quad(lambda w: w**2 * heavy[1](w), 0, r, limit=400)[0] for r in reach]
    half = 0.5 * sigma
    tangent = scalar_contact(Adaptive(sigma=sigma), np.array([half]), F)
    per_mu = ("mu", "z")
    return xr.Dataset(
        {
            "lam_exact": quantity_of("z", scalar_contact(Exact(), z, F).lam, "N s", "exact"),
            "lam_constant": quantity_of(per_mu, [c.lam for c in constant], "N s", "constant mu"),
            "lam_adaptive": quantity_of("z", adaptive.lam, "N s", "adaptive mu"),
            "mu_adaptive": quantity_of("z", adaptive.mu, "N s m", "adaptive mu(z)"),
            "density_constant": quantity_of(per_mu, [F * c.curvature for c in constant], "1/m",
                                            "noise of constant mu, F S''"),
            "density_adaptive": quantity_of("z", F * adaptive.curvature, "1/m",
                                            "noise of adaptive mu, F S''"),
            "student": quantity_of(per_mu, [w(z) for w in heavy], "1/m",
                                   "Student t, 2 degrees of freedom, scale sqrt(2 F mu)"),
            "gaussian": quantity_of("z", gaussian(sigma)(z), "1/m", "N(0, sigma²)"),
            "printed_kappa": quantity_of("z", printed_kappa(z, sigma), "1", "eq. 5.1 as printed"),
            "printed_mass": quantity_of((), np.trapezoid(other.curvature, wide), "1",
                                        "integral of rho as printed, F = 2.5, mu = 0.1"),
            "quartic_slope": quantity_of((), quartic.slope.max(), "N s/m",
                                         "largest dlam/dz of eq. C.2"),
            "mismatch": quantity_of("law", mismatch, "N s", "max |E S_0(z + w) - S_mu(z)|"),
            "variance_within": quantity_of("reach", variance, "m^2",
                                           "variance of the noise of mu = 0.1 within |w| < reach"),
            "best_line": quantity_of(("norm", "coefficient"), linearisations(half, F, sigma), "1",
                                     "K and W of the best line at z = sigma/2"),
            "tangent": quantity_of("coefficient", [tangent.lam[0], tangent.slope[0]], "1",
                                   "softened solution and its gradient at z = sigma/2"),
        },
        {
            "z": quantity_of("z", z, "m", "gap at lam = 0"),
            "mu": quantity_of("mu", MUS, "N s m", "central-path parameter"),
            "reach": quantity_of("reach", reach, "m", "truncation"),
            "law": ("law", [*(f"mu = {mu:g}" for mu in MUS), "adaptive"]),
            "norm": ("norm", ["absolute", "squared"]),
            "coefficient": ("coefficient", ["K", "W"]),
        },
    )  # fmt: skip


def claims(data: xr.Dataset) -> list[Claim]:
    """What fig. 1 (c, d) and prop. 5.2, 5.3 say."""
    F, sigma, z = data.attrs["F"], data.attrs["sigma"], data["z"].values
    middle = len(z) // 2
    mu, far = data["mu_adaptive"].values, z >= data.attrs["far"] * sigma
    bend = float(data["density_adaptive"][middle]) / F
    bends = data["density_constant"].values[:, middle] / F
    error = np.abs(data["lam_adaptive"].values - data["lam_exact"].values)[far].max()
    errors = np.abs(data["lam_constant"].values - data["lam_exact"].values)[:, far].max(axis=1)
    mismatch, variance = data["mismatch"].values, data["variance_within"].values
    apart = np.abs(data["density_constant"].values / data["student"].values - 1).max()
    mass, slope = float(data["printed_mass"]), float(data["quartic_slope"])
    true, printed = float(data["lam_adaptive"][middle]), float(data["printed_kappa"][middle])
    line, tangent = data["best_line"].values, data["tangent"].values

    def pair(values: np.ndarray) -> str:
        return f"({values[0]:.3f}, {values[1]:.3f})"

    return [
        Claim("mu(z) is contact-aware: large only near z = 0", "ABS, fig. 1c",
              f"peak sigma²/(2 pi F) = {sigma**2 / (2 * np.pi * F):.4f}",
              f"{mu[middle]:.4f} at 0, {mu[far].max() / mu[middle]:.1e} of it beyond"
              f" {data.attrs['far']:g} sigma", bool(mu[far].max() < 0.01 * mu[middle])),
        Claim("mu(z) gives smoother dynamics than mu <= 0.1 around z = 0", "ABS, fig. 1d",
              "curvature below that of 0.01, 0.1", f"{bend:.3f} against {bends[0]:.3f},"
              f" {bends[1]:.3f} N s/m²", bool(bend < bends[1])),
        Claim("mu(z) best approximates the exact solution in contact-free regions",
              "ABS, fig. 1d", "error below every constant's",
              f"{error:.1e} against {errors[0]:.1e} N s (mu = 0.01)", bool(error < errors.min())),
        Claim("Constant mu is randomized smoothing by some noise", "ABS, prop. 5.2",
              "E S_0(z + w) = S_mu(z)", f"{mismatch[:-1].max():.1e} N s; density equals Student's"
              f" t_2 within {apart:.1e}", bool(mismatch[:-1].max() < 1e-9 and apart < 1e-6)),
        Claim("The noise has density rho = S_mu''(w)", "ABS, prop. 5.2",
              "integral 1", f"{mass:.4f} at F = 2.5: the factor F is missing; so is the sign, w ~"
              " F S''(-w)", abs(mass - 1) < 1e-2),
        Claim("The noise of constant mu has a variance", "ABS, prop. 5.2 with lemma A.4",
              "finite variance", f"{variance[0]:.2f}, {variance[1]:.2f}, {variance[2]:.2f} m²"
              " within 10, 100, 1000 m: grows as log",
              bool(np.diff(variance).max() < 0.01 * variance[0])),
        Claim("BS is RS for any mu(z)", "ABS, prop. 5.2", "dlam/dz <= 0 for eq. C.2",
              f"up to {slope:+.3f} N s/m: a negative density", slope <= 0),
        Claim("The adaptive mu is Gaussian smoothing", "eq. 5.1 corrected",
              "E S_0(z + w) = S_mu(z)", f"{mismatch[-1]:.1e} N s", bool(mismatch[-1] < 1e-9)),
        Claim("kappa as printed is the Gaussian-smoothed solution", "ABS, eq. 5.1",
              f"{true:.4f} N s at z = {z[middle]:.2f} m", f"{printed:.4f}",
              abs(printed - true) < 1e-6),
        Claim("K*, W* of the least absolute residual are S_mu and its gradient",
              "ABS, prop. 5.3", pair(tangent) + " at sigma/2", pair(line[0]),
              bool(np.allclose(line[0], tangent, atol=1e-3))),
        Claim("K*, W* of the least squared residual are S_mu and its gradient",
              "ABS, lemma A.4", pair(tangent) + " at sigma/2", pair(line[1]),
              bool(np.allclose(line[1], tangent, atol=2e-3))),
    ]  # fmt: skip


study = Study(
    id="A1",
    title="Contact impulse and adaptive mu over the gap, and their noise",
    citation=Citation("zhang2023adaptive", "Fig. 1c and 1d, propositions 5.2 and 5.3"),
    Params=Params,
    run=run,
    claims=claims,
    notes=(
        "mu(z) is the corrected eq. 5.1: kappa = (sigma pdf(z/sigma) - z tail(z/sigma))/F and"
        " mu = kappa (z + F kappa).",
        "The heavy tail of Student's t is the force at a distance of constant mu.",
        f"mu in {', '.join(map(str, MUS))} are our choice but for 0.1, which the caption names.",
    ),
)
