"""A3: variance of the first-order gradient over the length of unrolls, machines in training."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import xarray as xr

from dynamics.batch import DensePolicy, StepFunction
from dynamics.contact import Adaptive, Barrier, ContactLaw
from ocp.learning.experiment import Experiment
from ocp.learning.protocol import Trained
from problems.studies.shared.trainings import job
from problems.studies.study import Pieces, StudyParams, quantity_of, setting

TASKS = ("hopper", "half-cheetah")
LAWS: dict[str, ContactLaw] = {
    **{f"mu {mu:g}": Barrier(mu=mu) for mu in (1e-2, 1e-4, 1e-6, 1e-8, 1e-10)},
    "adaptive": Adaptive("quartic"),
}
LENGTHS = (1, 2, 3, 5, 7, 10, 15, 20)


class Params(StudyParams):
    """Parameters of A3; the paper names mu = 1e-10 and 1e-2 and no other number."""

    stages: int = setting(6, "1", "policies along the training", least=2)
    every: int = setting(10, "1", "iterations between them", least=1)
    unrolls: int = setting(256, "1", "unrolls of each law, length and policy", least=16)
    sigma: float = setting(0.02, "1", "noise on the actions before they are bounded", above=0)


def run(params: Params, pieces: Pieces) -> xr.Dataset:
    """Variances of all laws, lengths and policies of both tasks, and Lipschitz constants."""
    found = [pieces.get(task, lambda task=task: _task(task, params)) for task in TASKS]
    every = ("task", "stage", "law", "length")
    return xr.Dataset(
        {
            "variance": quantity_of(
                every, [f["variance"] for f in found], "1", "trace of one gradient's covariance"
            ),
            "lost": quantity_of(
                every, [f["lost"] for f in found], "1", "share of unrolls that are not finite"
            ),
            "lipschitz": quantity_of(
                ("task", "stage", "law"), [f["lipschitz"] for f in found], "1",
                "L_f, the largest norm of [A B]",
            ),
            "lipschitz_policy": quantity_of(
                ("task", "stage"), [f["lipschitz_policy"] for f in found], "1", "L_pi"
            ),
        },
        {
            "task": list(TASKS),
            "law": list(LAWS),
            "length": quantity_of("length", LENGTHS, "1", "unroll length H"),
            "stage": quantity_of(
                "stage", params.every * np.arange(params.stages), "1", "iterations of training"
            ),
        },
    )  # fmt: skip


def _task(task: str, params: Params) -> dict[str, np.ndarray]:
    asked = job(task, "fopg", LAWS["adaptive"], params.seed)
    experiment = asked.experiment()
    shape = (params.stages, len(LAWS))
    variance, lost = np.full((2, *shape, len(LENGTHS)), np.nan)
    lipschitz, of_policy = np.zeros(shape), np.zeros(params.stages)
    algorithm, k = asked.algorithm, 0
    state = algorithm.begin(experiment)
    for s in range(params.stages):
        trained = algorithm.policy(experiment, state)
        x0 = _visited(experiment, trained, params, s)
        of_policy[s] = _lipschitz_policy(experiment, trained, x0)
        for i, law in enumerate(LAWS.values()):
            lipschitz[s, i] = _lipschitz(experiment, law, trained, x0)
            for j, length in enumerate(LENGTHS):
                found = experiment.rollouts(length, law).moments(
                    x0, trained.theta, trained.normaliser,
                    noise=experiment.noise(params.sigma, s, "measured"), n_samples=len(x0),
                )  # fmt: skip
                assert found.gradient is not None
                lost[s, i, j] = found.nonfinite.count / len(x0)
                if found.gradient.n > 1:
                    variance[s, i, j] = found.gradient.m2.sum() / (found.gradient.n - 1)
        for _ in range(params.every * (s + 1 < params.stages)):
            state, _ = algorithm.iterate(experiment, state, k)
            k += 1
    return {"variance": variance, "lost": lost, "lipschitz": lipschitz,
            "lipschitz_policy": of_policy}  # fmt: skip


def _visited(experiment: Experiment, trained: Trained, params: Params, stage: int) -> np.ndarray:
    """States (n, nx) out of episodes of the policy under noise, each of them once at random."""
    rng = experiment.rng(stage, "visited")
    x0 = experiment.first_states(params.unrolls, rng)
    found = experiment.rollouts(experiment.task.horizon, LAWS["mu 1e-10"])(
        x0, trained.theta, trained.normaliser,
        noise=experiment.noise(params.sigma, stage, "visited"), n_samples=len(x0), states=True,
    )  # fmt: skip
    finite = np.isfinite(found.states).all(axis=2)
    alive = np.arange(found.states.shape[1]) < np.maximum(found.lived, 1)[:, None]
    candidates = found.states[finite & alive]
    return candidates[rng.integers(len(candidates), size=params.unrolls)]


def _lipschitz(experiment: Experiment, law: ContactLaw, trained: Trained, x: np.ndarray) -> float:
    """Largest spectral norm of the step's slopes [A B] at states x under the policy."""
    task = experiment.task
    step = StepFunction(law.close(replace(task.system, parameters=task.parameters)), threads=1)
    steps, by_x, by_u = step.slopes(x, experiment.inputs(trained, x))
    good = np.isfinite(steps.x_next).all(axis=1)
    whole = np.concatenate([by_x[good], by_u[good]], axis=2)
    return float(np.linalg.norm(whole, ord=2, axis=(1, 2)).max())


def _lipschitz_policy(experiment: Experiment, trained: Trained, x: np.ndarray) -> float:
    """Largest spectral norm of the policy's slope at states x, by central differences."""
    assert isinstance(experiment.policy, DensePolicy)
    columns = []
    for i in range(x.shape[1]):
        e = np.zeros(x.shape[1])
        e[i] = 1e-6
        ahead, behind = (experiment.inputs(trained, x + s * e) for s in (1, -1))
        columns.append((ahead - behind) / 2e-6)
    return float(np.linalg.norm(np.stack(columns, axis=-1), ord=2, axis=(1, 2)).max())
