"""A5: first-order policy gradients on the half-cheetah through contact of different mu."""

from __future__ import annotations

import numpy as np
import xarray as xr

from dynamics.contact import Adaptive, Barrier, ContactLaw
from problems.studies.shared.trainings import curves, job
from problems.studies.study import Pieces, StudyParams, quantity_of, setting

TASK = "half-cheetah"
LAWS: dict[str, ContactLaw] = {
    **{f"mu {mu:g}": Barrier(mu=mu) for mu in (1e-10, 1e-6, 1e-4, 1e-2)},
    "adaptive": Adaptive("quartic"),
    "adaptive, gaussian": Adaptive(sigma=0.02),
}


class Params(StudyParams):
    """Parameters of A5; the paper names mu = 1e-10 and 1e-2 and no other number."""

    runs: int = setting(5, "1", "seeds of each law", least=2)
    iterations: int = setting(150, "1", "steps of ascent", least=4)
    judged: int = setting(15, "1", "judgements along a run", least=2)


def run(params: Params, pieces: Pieces) -> xr.Dataset:
    """Exact returns and gradient variances of every run over its iterations."""
    every = max(1, params.iterations // params.judged)
    jobs = {
        f"{name}-{r}": job(TASK, "fopg", law, params.seed * 1000 + r,
                           iterations=params.iterations, evaluate_every=every)
        for name, law in LAWS.items() for r in range(params.runs)
    }  # fmt: skip
    found = list(curves(jobs, pieces).values())
    judged = np.flatnonzero(np.isfinite(found[0]["evaluation_return"]))
    shape = (len(LAWS), params.runs)

    def table(name: str, chosen: np.ndarray | slice) -> np.ndarray:
        return np.reshape([f[name][chosen] for f in found], (*shape, -1))

    one = ("law", "run", "iteration")
    return xr.Dataset(
        {
            "exact_return": quantity_of(one, table("evaluation_return", judged), "1", "return"),
            "speed": quantity_of(one, table("evaluation_speed", judged), "m/s", "mean speed"),
            "variance": quantity_of(
                ("law", "run", "step"), table("gradient_variance", slice(-1)), "1",
                "trace of one gradient's covariance",
            ),
        },
        {
            "law": list(LAWS),
            "iteration": quantity_of("iteration", judged, "1", "iteration"),
        },
    )  # fmt: skip
