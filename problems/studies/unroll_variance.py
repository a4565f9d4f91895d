"""A3: variance of the first-order gradient over the length of unrolls, at several stages of training."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import xarray as xr

from dynamics.batch import DensePolicy, StepFunction
from dynamics.contact import Adaptive, Barrier, ContactLaw
from ocp.learning.experiment import Experiment
from ocp.learning.protocol import TrainedPolicy
from problems.studies.progress import track_items
from problems.studies.shared.trainings import make_job
from problems.studies.study import Claim, FinishedParts, StudyParams, claim, dataset, setting, settings_text

NOTES = (
    "Every law and length differentiates the same policies from the same states, those of a"
    " training through the adaptive law, so that nothing differs but law and length.",
    "The variance is the trace of the covariance of one unroll's gradient, unrolls that are not"
    " finite left out and counted.",
    "Theorem 4.4 with its constant mended (errata, 28): v = O(H^4 (sqrt 2 L_f L_pi)^(4 H)); L_f"
    " is the largest norm of the step's slopes [A B] among the visited states, L_pi the"
    " policy's, in the states' and inputs' own units.",
)
QUICK = {"stages": 2, "every": 1, "unrolls": 16}
RESUMES = True

TASKS = ("hopper", "half-cheetah")
"""Tasks whose gradients are measured."""
LAWS: dict[str, ContactLaw] = {
    **{f"mu {mu:g}": Barrier(mu=mu) for mu in (1e-2, 1e-4, 1e-6, 1e-8, 1e-10)},
    "adaptive": Adaptive("quartic"),
}
"""Mapping from names to the contact laws of gradients; mu in N s m."""
LENGTHS = (1, 2, 3, 5, 7, 10, 15, 20)
"""Numbers of steps of the unrolls."""


class Params(StudyParams):
    """Parameters of study A3; the paper gives mu = 1e-10, mu = 1e-2 and no other number."""

    stages: int = setting(6, "1", "policies along the training", least=2)
    every: int = setting(10, "1", "iterations between them", least=1)
    unrolls: int = setting(256, "1", "unrolls of each law, length and policy", least=16)
    sigma: float = setting(0.02, "1", "noise on the actions before they are bounded", above=0)


def run(params: Params, finished: FinishedParts) -> xr.Dataset:
    """Compute gradient variances for all tasks, policies, laws and lengths, and Lipschitz constants."""
    task_results = [finished.get(task, lambda task=task: _task(task, params)) for task in track_items("tasks", TASKS)]
    every = ("task", "stage", "law", "length")
    return dataset(
        {
            "variance": (every, [f["variance"] for f in task_results], "1", "trace of one gradient's covariance"),
            "lost": (every, [f["lost"] for f in task_results], "1", "share of unrolls that are not finite"),
            "lipschitz": (
                ("task", "stage", "law"),
                [f["lipschitz"] for f in task_results],
                "1",
                "L_f, the largest norm of [A B]",
            ),
            "lipschitz_policy": (("task", "stage"), [f["lipschitz_policy"] for f in task_results], "1", "L_pi"),
        },
        {
            "task": list(TASKS),
            "law": list(LAWS),
            "length": (LENGTHS, "1", "unroll length H"),
            "stage": (params.every * np.arange(params.stages), "1", "iterations of training"),
        },
    )


def _task(task: str, params: Params) -> dict[str, np.ndarray]:
    training = make_job(task, "fopg", LAWS["adaptive"], params.seed)
    experiment = training.experiment()
    shape = (params.stages, len(LAWS))
    variance, lost = np.full((2, *shape, len(LENGTHS)), np.nan)
    lipschitz, of_policy = np.zeros(shape), np.zeros(params.stages)
    algorithm, iteration = training.algorithm, 0
    system = replace(experiment.task.system, parameters=experiment.task.parameters)
    steps = [StepFunction(law.close(system), threads=1) for law in LAWS.values()]
    state = algorithm.begin(experiment)
    for s in range(params.stages):
        trained = algorithm.policy(experiment, state)
        x0 = _visited(experiment, trained, params, s)
        of_policy[s] = _lipschitz_policy(experiment, trained, x0)
        for i, law in enumerate(LAWS.values()):
            lipschitz[s, i] = _lipschitz(experiment, steps[i], trained, x0)
            for j, length in enumerate(LENGTHS):
                moments = experiment.rollouts(length, law).moments(
                    x0,
                    trained.theta,
                    trained.normaliser,
                    noise=experiment.noise(params.sigma, s, "measured"),
                    n_samples=len(x0),
                )
                assert moments.gradient is not None
                lost[s, i, j] = moments.nonfinite.count / len(x0)
                if moments.gradient.n > 1:
                    variance[s, i, j] = moments.gradient.m2.sum() / (moments.gradient.n - 1)
        for _ in range(params.every * (s + 1 < params.stages)):
            state, _ = algorithm.iterate(experiment, state, iteration)
            iteration += 1
    return {"variance": variance, "lost": lost, "lipschitz": lipschitz, "lipschitz_policy": of_policy}


def _visited(experiment: Experiment, trained: TrainedPolicy, params: Params, stage: int) -> np.ndarray:
    """Return states (n, nx) from episodes of the policy with noise on its actions."""
    rng = experiment.rng(stage, "visited")
    x0 = experiment.first_states(params.unrolls, rng)
    episodes = experiment.rollouts(experiment.task.horizon, LAWS["mu 1e-10"])(
        x0,
        trained.theta,
        trained.normaliser,
        noise=experiment.noise(params.sigma, stage, "visited"),
        n_samples=len(x0),
        states=True,
    )
    finite = np.isfinite(episodes.states).all(axis=2)
    alive = np.arange(episodes.states.shape[1]) < np.maximum(episodes.lived, 1)[:, None]
    candidates = episodes.states[finite & alive]
    return candidates[rng.integers(len(candidates), size=params.unrolls)]


def _lipschitz(experiment: Experiment, step: StepFunction, trained: TrainedPolicy, x: np.ndarray) -> float:
    """Return the largest spectral norm of the step's slopes [A B] at states x under the policy."""
    steps, by_x, by_u = step.derivatives(x, experiment.inputs(trained, x))
    is_finite = np.isfinite(steps.x_next).all(axis=1)
    step_slopes = np.concatenate([by_x[is_finite], by_u[is_finite]], axis=2)
    return float(np.linalg.norm(step_slopes, ord=2, axis=(1, 2)).max())


def _lipschitz_policy(experiment: Experiment, trained: TrainedPolicy, x: np.ndarray) -> float:
    """Return the largest spectral norm of the policy's slope at states x, by central differences."""
    assert isinstance(experiment.policy, DensePolicy)
    columns = []
    for i in range(x.shape[1]):
        e = np.zeros(x.shape[1])
        e[i] = 1e-6
        forward, backward = (experiment.inputs(trained, x + s * e) for s in (1, -1))
        columns.append((forward - backward) / 2e-6)
    return float(np.linalg.norm(np.stack(columns, axis=-1), ord=2, axis=(1, 2)).max())


_SECTION_7_2 = "ABS, sec. 7.2"
"""Citation in the claims from the paper."""
# Names of the laws with the smallest and the largest mu, and of the adaptive one.
_SHARP = "mu 1e-10"
_WIDE = "mu 0.01"
_ADAPTIVE = "adaptive"
_SHORTEST_FITTED = 5
"""Shortest unroll [steps] in the fit of the growth rate; shorter unrolls may have no contact."""


@dataclass(frozen=True)
class Growth:
    """Growth rate of the log variance per step of the unroll, and its 95 % interval over the stages of training."""

    rate: float
    low: float
    high: float

    @property
    def error(self) -> float:
        """Standard error of the rate."""
        return (self.high - self.low) / 4

    def above(self, other: Growth) -> float:
        """Return the difference of the rate and the rate of ``other``, in standard errors of the difference."""
        return (self.rate - other.rate) / np.hypot(self.error, other.error)

    def __str__(self) -> str:
        return f"{self.rate:.2f} ({self.low:.2f} to {self.high:.2f})"


def variance_growth(data: xr.Dataset, task: str, law: str) -> Growth:
    """Return the mean growth rate of fits over stages, with two standard errors on each side; NaN for too few fits."""
    variances = data["variance"].sel(task=task, law=law)
    lengths = variances["length"].values
    chosen = lengths >= _SHORTEST_FITTED
    slopes = []
    for row in variances.transpose("stage", "length").values:
        is_fitted = chosen & (row > 0)
        if is_fitted.sum() > 2:
            slopes.append(np.polyfit(lengths[is_fitted], np.log(row[is_fitted]), 1)[0])
    if len(slopes) < 2:
        return Growth(np.nan, np.nan, np.nan)
    mean, error = float(np.mean(slopes)), float(np.std(slopes, ddof=1) / np.sqrt(len(slopes)))
    return Growth(mean, mean - 2 * error, mean + 2 * error)


def bound_rate(data: xr.Dataset, task: str, law: str) -> float:
    """Return the growth per step of log(bound) in theorem 4.4, ``4 log(sqrt 2 L_f L_pi)``, with L_f, L_pi >= 1."""
    slope = data["lipschitz"].sel(task=task, law=law).max("stage")
    policy = data["lipschitz_policy"].sel(task=task).max("stage")
    return float(4 * np.log(np.sqrt(2) * np.maximum(slope, 1) * np.maximum(policy, 1)))


def claims(data: xr.Dataset) -> list[Claim]:
    """Return the claims of Zhang et al. 2023, sec. 7.2, on fig. 3, and claims on theorem 4.4."""
    rates = {(t, law): variance_growth(data, t, law) for t in TASKS for law in LAWS}
    mean = data["variance"].mean("stage")
    last = mean.isel(length=-1)
    shares = {t: [float(last.sel(task=t, law=law) / last.sel(task=t, law=_SHARP)) for law in LAWS] for t in TASKS}
    wide, adaptive = list(LAWS).index(_WIDE), list(LAWS).index(_ADAPTIVE)
    exploding = [rates[t, _SHARP].low > 0 for t in TASKS]
    flatter = [rates[t, _WIDE].high < rates[t, _SHARP].low for t in TASKS]
    separations = [rates[t, _SHARP].above(rates[t, _WIDE]) for t in TASKS]
    ordered = [bool(np.all(np.diff(shares[t][:5]) >= 0)) for t in TASKS]
    below = [rates[t, law].low <= bound_rate(data, t, law) for t in TASKS for law in LAWS]
    loose = [bound_rate(data, t, _SHARP) / rates[t, _SHARP].rate for t in TASKS]
    constants = data["lipschitz"].max("stage")
    falling = [float(constants.sel(task=t, law=_WIDE)) < float(constants.sel(task=t, law=_SHARP)) for t in TASKS]
    return [
        claim("The variance explodes with the unroll length at mu = 1e-10", _SECTION_7_2)
        .expected(f"log variance grows from H = {_SHORTEST_FITTED} on, 95 % over policies")
        .measured(f"{settings_text(TASKS, exploding)}: {', '.join(str(rates[t, _SHARP]) for t in TASKS)} a step")
        .holds(exploding, margin=min(r.rate / r.error for r in (rates[t, _SHARP] for t in TASKS))),
        claim("As mu increases the variance decreases", _SECTION_7_2)
        .expected("at the longest unroll, over mu = 1e-2 down to 1e-10 never falling")
        .measured(
            f"{settings_text(TASKS, ordered)}: "
            + "; ".join(", ".join(f"{s:.2g}" for s in shares[t][:5]) for t in TASKS)
            + f" of that at {_SHARP}"
        )
        .holds(ordered),
        claim("At mu = 1e-2 it grows more slowly than at 1e-10", _SECTION_7_2)
        .expected("intervals of the growth apart")
        .measured(f"{settings_text(TASKS, flatter)}: {', '.join(str(rates[t, _WIDE]) for t in TASKS)} a step")
        .holds(flatter, margin=min(separations)),
        claim("The adaptive law's variance lies between", "our check")
        .expected("at the longest unroll between those of mu = 1e-2 and 1e-10")
        .measured(
            "; ".join(
                f"{t} {shares[t][adaptive]:.2g} of that at {_SHARP}, {_WIDE} has {shares[t][wide]:.2g}" for t in TASKS
            )
        )
        .holds(all(min(shares[t][wide], 1) <= shares[t][adaptive] <= max(shares[t][wide], 1) for t in TASKS)),
        claim("The growth stays below theorem 4.4's", "ABS, thm. 4.4, constant mended")
        .expected("4 log(sqrt 2 L_f L_pi) a step")
        .measured(
            f"bounds {', '.join(f'{bound_rate(data, t, _SHARP):.3g}' for t in TASKS)} at"
            f" {_SHARP}, {', '.join(f'{r:.2g}' for r in loose)} times the growth"
        )
        .holds(below),
        claim("A larger mu means a larger Lipschitz constant", "ABS, sec. 7.2, as printed")
        .expected("L_f at mu = 1e-2 above that at 1e-10")
        .measured(
            ", ".join(
                f"{t} {float(constants.sel(task=t, law=_WIDE)):.3g} and {float(constants.sel(task=t, law=_SHARP)):.3g}"
                for t in TASKS
            )
        )
        .holds(not any(falling)),
    ]
