"""A4: policies for machines trained by seven algorithms, judged under the exact law."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr

from dynamics.contact import Adaptive, Barrier, ContactLaw
from problems.studies.shared.trainings import Curves, at, curves, job
from problems.studies.study import Pieces, StudyParams, quantity_of, setting
from problems.tasks.training import TrainingJob

TASKS = ("hopper", "half-cheetah")
POINTS = 60
EPISODES = 16
"""Of each judgement."""


@dataclass(frozen=True)
class Method:
    """An algorithm, the law that it learns through, and its share of the simulated steps."""

    algorithm: str
    law: ContactLaw
    share: float = 1.0


_SHARP = Barrier(mu=1e-10)
METHODS = {
    "FOPG-ABS": Method("fopg", Adaptive("quartic")),
    "FOPG": Method("fopg", _SHARP),
    "ZOPG": Method("zopg", _SHARP),
    "ARS": Method("ars", _SHARP),
    "PIPPS": Method("pipps", _SHARP, share=0.1),
    "AoBG": Method("aobg", _SHARP),
    "MBPO": Method("mbpo", _SHARP, share=0.01),
}


class Params(StudyParams):
    """Parameters of A4; the paper states none but the number of seeds."""

    runs: int = setting(5, "1", "seeds of each algorithm and task", least=2)
    kilosteps: int = setting(500, "1", "thousand simulated steps of each run", least=1)
    judged: int = setting(20, "1", "judgements along a run", least=2)


def run(params: Params, pieces: Pieces) -> xr.Dataset:
    """Returns of every run over simulated steps and over time, and what the best policy does."""
    jobs = {
        f"{task}-{name}-{r}": _job(task, METHODS[name], params, r)
        for task in TASKS for name in METHODS for r in range(params.runs)
    }  # fmt: skip
    found = curves(jobs, pieces)
    steps = np.geomspace(1e3, 1e3 * params.kilosteps, POINTS)
    wall = np.geomspace(0.1, max(float(np.nanmax(f["wall_s"])) for f in found.values()), POINTS)

    def table(of: str) -> np.ndarray:
        rows = [_held(f, of, steps if of == "env_steps" else wall) for f in found.values()]
        return np.reshape(rows, (len(TASKS), len(METHODS), params.runs, POINTS))

    def best(of: str) -> np.ndarray:
        rows = [f[of][np.nanargmax(f["evaluation_return"])] for f in found.values()]
        return np.reshape(rows, (len(TASKS), len(METHODS), params.runs))

    every, one = ("task", "algorithm", "run"), ("task", "algorithm", "run")
    return xr.Dataset(
        {
            "by_steps": quantity_of((*every, "steps"), table("env_steps"), "1", "exact return"),
            "by_time": quantity_of((*every, "wall"), table("wall_s"), "1", "exact return"),
            "best": quantity_of(one, best("evaluation_return"), "1", "best exact return"),
            "speed": quantity_of(one, best("evaluation_speed"), "m/s", "mean speed of the best"),
            "length": quantity_of(one, best("evaluation_length"), "1", "steps that it lives"),
        },
        {
            "task": list(TASKS),
            "algorithm": list(METHODS),
            "steps": quantity_of("steps", steps, "1", "simulated steps"),
            "wall": quantity_of("wall", wall, "s", "wall time"),
        },
    )


def _held(found: Curves, along: str, grid: np.ndarray) -> np.ndarray:
    return at(grid, found[along], found["evaluation_return"])


def _job(task: str, method: Method, params: Params, run: int) -> TrainingJob:
    """A training of so many iterations as the simulated steps allow, were no episode to end."""
    seed = params.seed * 1000 + run
    first = job(task, method.algorithm, method.law, seed)
    iterations = max(2, round(1e3 * params.kilosteps * method.share / _steps(first)))
    every = max(1, iterations // params.judged)
    return job(task, method.algorithm, method.law, seed, iterations=iterations,
               evaluate_every=every, episodes=EPISODES)  # fmt: skip


def _steps(asked: TrainingJob) -> float:
    """Simulated steps of an iteration at most."""
    known, horizon = asked.algorithm.settings(), asked.experiment().task.horizon
    if "directions" in known:
        return 2 * known["directions"] * horizon
    if "walkers" in known:
        return known["walkers"] * known["steps"]
    return known["samples"] * min(known["unroll"], horizon)
