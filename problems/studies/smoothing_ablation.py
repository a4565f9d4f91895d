"""A5: first-order policy gradients of the half-cheetah through contact laws with different mu."""

from __future__ import annotations

import numpy as np
import xarray as xr

from dynamics.contact import Adaptive, Barrier, ContactLaw
from problems.studies.shared.trainings import claim_gains, make_job, mean_difference, mean_height, training_curves
from problems.studies.study import Claim, FinishedParts, StudyParams, claim, dataset, setting

NOTES = (
    "All curves are returns of whole episodes of 5 s under the exact law, without noise on the"
    " actions; the paper's axis gives neither law nor noise.",
    "FOPG as ocp train has it for the task, with the plain mean of gradients of eq. 4.2.",
)
QUICK = {"runs": 2, "iterations": 4, "judged": 2}
RESUMES = True

TASK = "half-cheetah"
"""Task of all training runs."""
LAWS: dict[str, ContactLaw] = {
    **{f"mu {mu:g}": Barrier(mu=mu) for mu in (1e-10, 1e-6, 1e-4, 1e-2)},
    "adaptive": Adaptive("quartic"),
    "adaptive, gaussian": Adaptive(sigma=0.02),
}
"""Mapping from names to the contact laws of gradients; mu in N s m, sigma in m."""


class Params(StudyParams):
    """Parameters of study A5; the paper gives mu = 1e-10, mu = 1e-2 and no other number."""

    runs: int = setting(5, "1", "seeds of each law", least=2)
    iterations: int = setting(150, "1", "steps of ascent", least=4)
    judged: int = setting(15, "1", "evaluations along a run", least=2)


def run(params: Params, finished: FinishedParts) -> xr.Dataset:
    """Compute exact returns, speeds and gradient variances at the iterations of every run."""
    every = max(1, params.iterations // params.judged)
    jobs = {
        f"{name}-{r}": make_job(
            TASK, "fopg", law, params.seed * 1000 + r, iterations=params.iterations, evaluate_every=every
        )
        for name, law in LAWS.items()
        for r in range(params.runs)
    }
    trainings = list(training_curves(jobs, finished).values())
    evaluated = np.flatnonzero(np.isfinite(trainings[0]["evaluation_return"]))
    shape = (len(LAWS), params.runs)

    def table(name: str, chosen: np.ndarray | slice) -> np.ndarray:
        return np.reshape([f[name][chosen] for f in trainings], (*shape, -1))

    dimensions = ("law", "run", "iteration")
    return dataset(
        {
            "exact_return": (dimensions, table("evaluation_return", evaluated), "1", "return"),
            "speed": (dimensions, table("evaluation_speed", evaluated), "m/s", "mean speed"),
            "variance": (
                ("law", "run", "step"),
                table("gradient_variance", slice(-1)),
                "1",
                "trace of one gradient's covariance",
            ),
        },
        {"law": list(LAWS), "iteration": (evaluated, "1", "iteration")},
    )


_SECTION_7_4 = "ABS, sec. 7.4"
"""Citation in the claims from the paper."""
_SHARP = "mu 1e-10"
"""Name of the law with the smallest mu in the paper."""
_WIDE = "mu 0.01"
"""Name of the law with the largest mu in the paper."""
_ADAPTIVE = ("adaptive", "adaptive, gaussian")
"""Names of the adaptive laws."""


def claims(data: xr.Dataset) -> list[Claim]:
    """Return claims on mu = 1e-10, on mu = 1e-2 and on the adaptive laws."""
    laws = [str(law) for law in data["law"].values]
    curves = {law: data["exact_return"].sel(law=law).values for law in laws}
    areas = {law: mean_height(curve) for law, curve in curves.items()}
    ends = {law: curve.max(axis=1) for law, curve in curves.items()}
    fixed = [law for law in laws if law not in _ADAPTIVE]
    slower = mean_difference(areas[_WIDE], areas[_SHARP])
    lower = mean_difference(ends[_SHARP], ends[_WIDE])
    variance = {law: np.nanmedian(data["variance"].sel(law=law), axis=1) for law in laws}
    sharp = np.log10(variance[_SHARP])
    falling = [mean_difference(sharp, np.log10(variance[law])) for law in laws[1:]]
    return [
        claim("mu = 1e-10 learns slowly", _SECTION_7_4)
        .expected("mean return over iterations below that of mu = 1e-2, 95 % over seeds")
        .measured(str(slower))
        .holds(slower.better, margin=slower.margin),
        claim_gains(
            "for its gradient has the higher variance",
            _SECTION_7_4,
            "decades of a run's median above every other law's, 95 % over seeds",
            laws[1:],
            falling,
        ),
        claim("mu = 1e-2 ends lower", _SECTION_7_4)
        .expected("best return below that of mu = 1e-10, 95 %")
        .measured(str(lower))
        .holds(lower.better, margin=lower.margin),
        *(claim for law in _ADAPTIVE for claim in _on_top(law, fixed, ends, areas)),
    ]


def _on_top(law: str, fixed: list[str], ends: dict[str, np.ndarray], areas: dict[str, np.ndarray]) -> list[Claim]:
    """Check that returns under an adaptive law are higher than under every fixed mu."""
    source, name = "our check", "The law matched to Gaussian noise"
    if law == _ADAPTIVE[0]:
        source, name = _SECTION_7_4, "The adaptive law"
    return [
        claim_gains(
            f"{name} {sentence}",
            source,
            f"{expected} above that of every fixed mu, 95 %",
            fixed,
            [mean_difference(of[law], of[other]) for other in fixed],
        )
        for sentence, expected, of in (
            ("ends the highest", "best return", ends),
            ("learns the fastest", "mean return over iterations", areas),
        )
    ]
