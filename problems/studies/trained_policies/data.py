"""A4: policies for machines trained by seven algorithms, judged under the exact law."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from dynamics.contact import Adaptive, Barrier, ContactLaw
from ocp.learning.experiment import Budget
from problems.studies.shared.trainings import Curves, at, curves, job
from problems.studies.study import Pieces, StudyParams, quantity_of, setting
from problems.studies.trained_policies import plans
from problems.tasks.episodes import policy_of
from problems.tasks.training import TrainingJob

TASKS = ("hopper", "half-cheetah")
POINTS = 60
EPISODES = 16
"""Of each judgement."""


@dataclass(frozen=True)
class Method:
    """An algorithm, the law that it learns through, and the layers of its policy."""

    algorithm: str
    law: ContactLaw
    hidden: tuple[int, ...] = ()
    shown: bool = False
    """Whether it begins at a policy fitted to plans."""


_SHARP, _ABS = Barrier(mu=1e-10), Adaptive("quartic")
NETWORK, SHOWN = "FOPG-ABS, network", "the same, from plans"
MODEL_BASED = "MBPO"
"""Whose updates a step cost too much to spend the budget; it has iterations instead."""
METHODS = {
    "FOPG-ABS": Method("fopg", _ABS),
    "FOPG": Method("fopg", _SHARP),
    "ZOPG": Method("zopg", _SHARP),
    "ARS": Method("ars", _SHARP),
    "Total propagation": Method("total-propagation", _SHARP),
    "AoBG": Method("aobg", _SHARP),
    MODEL_BASED: Method("mbpo", _SHARP, hidden=plans.HIDDEN),
    NETWORK: Method("fopg", _ABS, hidden=plans.HIDDEN),
    SHOWN: Method("fopg", _ABS, hidden=plans.HIDDEN, shown=True),
}


class Params(StudyParams):
    """Parameters of A4; the paper states none but the number of seeds."""

    runs: int = setting(5, "1", "seeds of each algorithm and task", least=2)
    kilosteps: int = setting(200, "1", "thousand simulated steps of each run", least=1)
    model_based: int = setting(16, "1", "iterations of MBPO instead", least=2)
    judged: int = setting(20, "1", "judgements along a run", least=2)
    plans: int = setting(4, "1", "starts that episodes are planned from", least=1)


def run(params: Params, pieces: Pieces) -> xr.Dataset:
    """Returns of every run over simulated steps and over time, and what the best policy does."""
    shown = plans.plans(TASKS, params.plans, pieces)
    jobs = {
        f"{task}-{name}-{r}": _job(task, METHODS[name], params, r, shown[task])
        for task in TASKS for name in METHODS for r in range(params.runs)
    }  # fmt: skip
    found = curves(jobs, pieces)
    own = {key: f for key, f in found.items() if jobs[key].algorithm.name == "mbpo"}
    steps = np.linspace(0, 1e3 * params.kilosteps, POINTS)
    few = np.linspace(0, max(float(f["env_steps"][-1]) for f in own.values()), POINTS)
    wall = np.linspace(0, max(float(np.nanmax(f["wall_s"])) for f in found.values()), POINTS)

    def table(along: str, grid: np.ndarray, of: Mapping[str, Curves] = found) -> np.ndarray:
        rows = [at(grid, f[along], f["evaluation_return"]) for f in of.values()]
        return np.reshape(rows, (len(TASKS), -1, params.runs, POINTS))

    def best(of: str) -> np.ndarray:
        rows = [f[of][np.nanargmax(f["evaluation_return"])] for f in found.values()]
        return np.reshape(rows, (len(TASKS), len(METHODS), params.runs))

    every = one = ("task", "algorithm", "run")
    spent = np.reshape([f["env_steps"][-1] for f in found.values()], (len(TASKS), -1, params.runs))
    return xr.Dataset(
        {
            "by_steps": quantity_of(
                (*every, "steps"), table("env_steps", steps), "1", "exact return"
            ),
            "model_based": quantity_of(
                ("task", "run", "few"), table("env_steps", few, own)[:, 0], "1", "exact return"
            ),
            "by_time": quantity_of((*every, "wall"), table("wall_s", wall), "1", "exact return"),
            "spent": quantity_of(one, spent, "1", "steps simulated to learn from"),
            "best": quantity_of(one, best("evaluation_return"), "1", "best exact return"),
            "speed": quantity_of(one, best("evaluation_speed"), "m/s", "mean speed of the best"),
            "length": quantity_of(one, best("evaluation_length"), "1", "steps that it lives"),
            **_against_plans(params, pieces, shown, jobs, found),
        },
        {
            "task": list(TASKS),
            "algorithm": list(METHODS),
            "steps": quantity_of("steps", steps, "1", "simulated steps"),
            "few": quantity_of("few", few, "1", "simulated steps of MBPO"),
            "wall": quantity_of("wall", wall, "s", "wall time"),
            "guess": ["held inputs", "best policy"],
        },
    )


def _against_plans(
    params: Params,
    pieces: Pieces,
    shown: Mapping[str, list[Curves]],
    jobs: Mapping[str, TrainingJob],
    found: Mapping[str, Curves],
) -> dict[str, tuple[Any, np.ndarray, dict[str, str]]]:
    """Returns over the steps of a plan: of plans from both guesses, and of every policy."""
    n = params.plans
    policies = {
        key: plans.Policy(job.task, policy_of(found[key]), job.options["hidden"])
        for key, job in jobs.items()
    }
    reached = {key: policy.returns(n) for key, policy in policies.items()}
    best = {
        task: max((key for key in jobs if jobs[key].task == task), key=lambda k: reached[k].mean())
        for task in TASKS
    }
    near = plans.plans(TASKS, n, pieces, {task: policies[key] for task, key in best.items()})

    def told(of: str) -> np.ndarray:
        return np.array(
            [[[one[of] for one in guess[task]] for guess in (shown, near)] for task in TASKS]
        )

    shape = (len(TASKS), len(METHODS), params.runs, n)
    each = ("task", "guess", "start")
    return {
        "planned": quantity_of(each, told("returned"), "1", "return of a plan"),
        "replayed": quantity_of(each, told("replayed"), "1", "exact return of its inputs"),
        "certified": quantity_of(each, told("certified"), "1", "whether it is certified"),
        "reached": quantity_of(
            ("task", "algorithm", "run", "start"), np.reshape(list(reached.values()), shape), "1",
            "exact return of a policy over as many steps",
        ),
    }  # fmt: skip


def _job(task: str, method: Method, params: Params, run: int, shown: list[Curves]) -> TrainingJob:
    """A training that spends the budget, or MBPO's iterations."""
    seed = params.seed * 1000 + run
    start = plans.fitted(task, shown, seed) if method.shown else None
    asked: dict[str, Any] = {"budget": Budget(1000 * params.kilosteps, params.judged)}
    if method.algorithm == "mbpo":
        every = max(1, params.model_based // params.judged)
        asked = {"iterations": params.model_based, "evaluate_every": every}
    return job(task, method.algorithm, method.law, seed, hidden=method.hidden, episodes=EPISODES,
               start=start, **asked)  # fmt: skip
