"""P7: interpolation of first- and zeroth-order gradients in cases where the first-order gradient is biased."""

from __future__ import annotations

import numpy as np
import xarray as xr

from ocp.gradients import SampledObjective, estimate_gradient
from ocp.gradients.estimators import ConfidenceTest, FixedWeight
from ocp.gradients.sampling import reference_gradient
from problems.registry import objective_spec
from problems.studies.study import Claim, StudyParams, claim, dataset, setting, share_margin

NOTES = (
    "alpha is the weight of the first order here; eq. 6 of the paper has it the other way.",
    "The bound on a single sample's deviation is the largest that the samples show.",
    "The zeroth order has the mean of the other samples as baseline, on its own noise.",
)

ESTIMATORS = ("zobg-mean", "fobg", "alpha-fixed", "alpha-variance", "alpha")
"""Names of the estimators that are compared."""
CASES = ("heaviside", "coulomb", "ball-wall")
"""Names of the objectives on which the estimators are compared."""

QUICK = {"n_samples": 500, "repeats": 8}


class Params(StudyParams):
    """Parameters of study P7; all defaults are our choice, since the paper has no figure of interpolation."""

    n_samples: int = setting(2000, "1", "samples of each order", least=2)
    points: int = setting(21, "1", "decisions", least=3)
    repeats: int = setting(20, "1", "runs at each decision", least=2)
    alpha: float = setting(0.5, "1", "constant weight of the first order", least=0, most=1)
    gamma: float = setting(0.2, "1", "allowed error over the largest gradient", above=0)
    delta: float = setting(0.05, "1", "probability that the test fails", above=0, most=1)
    nu: float = setting(1e-4, "m/s", "slip tolerance", above=0)


def _grids(params: Params) -> dict[str, tuple[SampledObjective, np.ndarray, float]]:
    """Return a mapping from case to its objective, decisions and standard deviation of the noise."""
    coulomb = objective_spec("coulomb").objective({"nu": params.nu})
    return {
        "heaviside": (objective_spec("heaviside").objective(), np.linspace(-0.8, 0.8, params.points), 0.2),
        "coulomb": (coulomb, np.linspace(-0.4, 0.4, params.points), 0.1),
        "ball-wall": (objective_spec("ball-wall").objective(), np.linspace(0.6, 0.8, params.points), 0.02),
    }


def run(params: Params) -> xr.Dataset:
    """Compute the true gradient, and estimates and weights of every run, over the decisions of each case."""
    shape = (len(CASES), len(ESTIMATORS), params.points, params.repeats)
    mean, alpha = np.full(shape, np.nan), np.full(shape, np.nan)
    thetas, truth, gammas = [], [], []
    for c, (objective, grid, sigma) in enumerate(_grids(params).values()):
        objectives = [objective.at({"theta": theta}) for theta in grid]
        references = [reference_gradient(o, sigma, np.random.SeedSequence(0), 0) for o in objectives]
        true = np.array([k.gradient[0] for k in references if k is not None])
        gamma = params.gamma * float(np.abs(true).max())
        rules = (FixedWeight(params.alpha), ConfidenceTest(gamma, params.delta))
        for i, at_theta in enumerate(objectives):
            for r in range(params.repeats):
                seed = np.random.SeedSequence(params.seed, spawn_key=(c, i, r))
                estimates = estimate_gradient(
                    at_theta, ESTIMATORS, params.n_samples, sigma, seed, rules=rules, reference="none"
                )
                for j, estimate in enumerate(estimates.values()):
                    mean[c, j, i, r] = estimate.mean[0]
                    if estimate.choice is not None:
                        alpha[c, j, i, r] = estimate.choice.alpha
        thetas.append(grid)
        truth.append(true)
        gammas.append(gamma)
    every = ("case", "estimator", "point", "run")
    unit = "1 over the unit of theta"
    return dataset(
        {
            "theta": (("case", "point"), thetas, "1, m/s and rad", "decision"),
            "truth": (("case", "point"), truth, unit, "gradient"),
            "mean": (every, mean, unit, "estimate of each run"),
            "alpha": (every, alpha, "1", "weight of the first order"),
            "gamma_of_case": ("case", gammas, unit, "allowed error"),
        },
        {"case": list(CASES), "estimator": list(ESTIMATORS)},
    )


def _worst(data: xr.Dataset, case: str, estimator: str) -> float:
    """Return the largest root-mean-square error over all decisions, relative to the largest gradient."""
    runs = data.sel(case=case)
    errors = runs["mean"].sel(estimator=estimator) - runs["truth"]
    size = float(np.abs(runs["truth"]).max())
    return float(np.sqrt((errors**2).mean("run")).max()) / size


def claims(data: xr.Dataset) -> list[Claim]:
    """Return the claims of Suh et al. 2022, sec. IV-C, and our own checks."""
    gamma, delta = data.attrs["gamma"], data.attrs["delta"]
    steps = data.sel(case="heaviside")
    zeros = steps["alpha"].sel(estimator="alpha-variance") == 1
    fooled = float(zeros.mean())
    errors = np.abs(data["mean"].sel(estimator="alpha") - data["truth"])
    within = errors <= data["gamma_of_case"]
    share_within = float(within.mean())
    blind = data.sel(case="coulomb", estimator="alpha-variance")
    blind_share = float((blind["alpha"] == 1).mean())
    worst = {(c, e): _worst(data, c, e) for c in CASES for e in ESTIMATORS}
    fixed = [worst[c, "alpha-fixed"] for c in CASES]
    wall = data.sel(case="ball-wall")
    spread = wall["mean"].std("run")
    farthest = int(np.abs(wall["theta"].values - wall["theta"].values.min()).argmin())
    gain = float(spread.sel(estimator="alpha")[farthest] / spread.sel(estimator="zobg-mean")[farthest])
    return [
        claim("Empirical variance is an unreliable guide where the first order is biased", "Pathologies, sec. IV-C")
        .expected("inverse variance takes the Heaviside's zeros alone, alpha = 1")
        .measured(f"in {fooled:.0%} of runs, error {worst['heaviside', 'alpha-variance']:.3f} of the largest gradient")
        .holds(fooled > 0.99, margin=share_margin(zeros, 0.99)),
        claim("The same happens under empirical bias", "our check")
        .expected("alpha = 1 where no sample falls within nu")
        .measured(f"in {blind_share:.0%} of runs, error {worst['coulomb', 'alpha-variance']:.3f}")
        .holds(blind_share > 0.1, margin=share_margin(blind["alpha"] == 1, 0.1)),
        claim("A confidence interval from the zeroth order mends it", "Pathologies, sec. IV-C")
        .expected(f"error <= gamma = {gamma:g} of the largest gradient, with probability {1 - delta:g}")
        .measured(f"in {share_within:.2%} of all runs")
        .holds(share_within >= 1 - delta, margin=share_margin(within, 1 - delta)),
        claim("A constant weight carries its share of the bias", "our check")
        .expected(f"about {data.attrs['alpha']:g} where the first order is zero")
        .measured(f"{fixed[0]:.3f} on the Heaviside")
        .equals(fixed[0], data.attrs["alpha"], within=0.1),
        claim("Where the first order is right, the interpolation is the more accurate for it", "our check")
        .expected("spread below the zeroth order's")
        .measured(f"{gain:.2g} of it at theta = {float(wall['theta'][farthest]):g} rad, far from the corner")
        .below(gain, 0.5),
    ]
