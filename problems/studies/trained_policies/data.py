"""A4: policies of hopper and half-cheetah, trained by seven algorithms and evaluated under the exact law."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from dynamics.contact import Adaptive, Barrier, ContactLaw
from ocp.jobs.scheduling import Report
from ocp.learning.experiment import EXACT, Budget, Experiment
from ocp.learning.imitation import demonstrations, fit_actions
from ocp.learning.planned import best_plan, guess_from_constant_inputs, guess_from_policy
from ocp.learning.protocol import TrainedPolicy
from ocp.learning.training import evaluate_from
from ocp.learning.unroll_gradients import FOPG
from problems.studies.shared.trainings import Curves, interpolate_finite, make_job, side_by_side, training_curves
from problems.studies.study import FinishedParts, StudyParams, dataset, setting
from problems.tasks import registry
from problems.tasks.training import TrainingJob, policy_of

QUICK = {"runs": 2, "kilosteps": 2, "model_based": 2, "judged": 2, "plans": 1}
RESUMES = True


TASKS = ("hopper", "half-cheetah")
"""Names of the tasks for which policies are trained."""
POINTS = 60
"""Number of points on each axis for the interpolation of returns."""
HIDDEN = (32, 32)
"""Widths of the hidden layers of all networks."""
EPISODES = 16
"""Number of episodes in each evaluation."""


@dataclass(frozen=True)
class Method:
    """Algorithm, contact law of its model, and widths of the policy's hidden layers (empty for an affine policy)."""

    algorithm: str
    law: ContactLaw
    hidden: tuple[int, ...] = ()
    shown: bool = False
    """Whether learning starts from a network fitted to plans."""


_SHARP_LAW = Barrier(mu=1e-10)
"""Barrier law that replaces the exact law in gradients."""
_ABS_LAW = Adaptive("quartic")
"""The adaptive law of the paper."""
NETWORK = "FOPG-ABS, network"
"""Name of the method whose network starts from random weights."""
SHOWN = "the same, from plans"
"""Name of the method whose network starts from a fit to plans."""
MODEL_BASED = "MBPO"
"""Name of the method with a limit on iterations, since its updates take too long for the step budget."""
METHODS = {
    "FOPG-ABS": Method("fopg", _ABS_LAW),
    "FOPG": Method("fopg", _SHARP_LAW),
    "ZOPG": Method("zopg", _SHARP_LAW),
    "ARS": Method("ars", _SHARP_LAW),
    "Total propagation": Method("total-propagation", _SHARP_LAW),
    "AoBG": Method("aobg", _SHARP_LAW),
    MODEL_BASED: Method("mbpo", _SHARP_LAW, hidden=HIDDEN),
    NETWORK: Method("fopg", _ABS_LAW, hidden=HIDDEN),
    SHOWN: Method("fopg", _ABS_LAW, hidden=HIDDEN, shown=True),
}
"""Mapping from names to methods, in the order of the data."""


class Params(StudyParams):
    """Parameters of study A4; the paper states only the number of seeds."""

    runs: int = setting(5, "1", "seeds of each algorithm and task", least=2)
    kilosteps: int = setting(200, "1", "thousand simulated steps of each run", least=1)
    model_based: int = setting(16, "1", "iterations of MBPO instead", least=2)
    judged: int = setting(20, "1", "evaluations along a run", least=2)
    plans: int = setting(4, "1", "starts that episodes are planned from", least=1)


def run(params: Params, finished: FinishedParts) -> xr.Dataset:
    """Compute returns over simulated steps and wall time, returns and speeds of best policies, and returns of plans."""
    plans_shown = make_plans(TASKS, params.plans, finished)
    jobs = {
        f"{task}-{name}-{r}": _job(task, METHODS[name], params, r, plans_shown[task])
        for task in TASKS
        for name in METHODS
        for r in range(params.runs)
    }
    trainings = training_curves(jobs, finished)
    model_based = {key: f for key, f in trainings.items() if jobs[key].algorithm.name == "mbpo"}
    steps = np.linspace(0, 1e3 * params.kilosteps, POINTS)
    few = np.linspace(0, max(float(f["env_steps"][-1]) for f in model_based.values()), POINTS)
    wall = np.linspace(0, max(float(np.nanmax(f["wall_s"])) for f in trainings.values()), POINTS)

    def table(along: str, grid: np.ndarray, of: Mapping[str, Curves] = trainings) -> np.ndarray:
        rows = [interpolate_finite(grid, f[along], f["evaluation_return"]) for f in of.values()]
        return np.reshape(rows, (len(TASKS), -1, params.runs, POINTS))

    def best(of: str) -> np.ndarray:
        rows = [f[of][np.nanargmax(f["evaluation_return"])] for f in trainings.values()]
        return np.reshape(rows, (len(TASKS), len(METHODS), params.runs))

    every = dimensions = ("task", "algorithm", "run")
    by_few = table("env_steps", few, model_based)[:, 0]
    spent = np.reshape([f["env_steps"][-1] for f in trainings.values()], (len(TASKS), -1, params.runs))
    return dataset(
        {
            "by_steps": ((*every, "steps"), table("env_steps", steps), "1", "exact return"),
            "model_based": (("task", "run", "few"), by_few, "1", "exact return"),
            "by_time": ((*every, "wall"), table("wall_s", wall), "1", "exact return"),
            "spent": (dimensions, spent, "1", "steps simulated to learn from"),
            "best": (dimensions, best("evaluation_return"), "1", "best exact return"),
            "speed": (dimensions, best("evaluation_speed"), "m/s", "mean speed of the best"),
            "length": (dimensions, best("evaluation_length"), "1", "steps that it lives"),
            **_against_plans(params, finished, plans_shown, jobs, trainings),
        },
        {
            "task": list(TASKS),
            "algorithm": list(METHODS),
            "steps": (steps, "1", "simulated steps"),
            "few": (few, "1", "simulated steps of MBPO"),
            "wall": (wall, "s", "wall time"),
            "guess": ["held inputs", "best policy"],
        },
    )


def _against_plans(
    params: Params,
    finished: FinishedParts,
    shown: Mapping[str, list[Curves]],
    jobs: Mapping[str, TrainingJob],
    trainings: Mapping[str, Curves],
) -> dict[str, Any]:
    """Compute returns of plans and, over as many steps, of every policy.

    Plans start from guesses with constant inputs (``shown``) and from motions of each task's best policy.
    """
    n = params.plans
    policies = {key: Policy(job.task, policy_of(trainings[key]), job.options["hidden"]) for key, job in jobs.items()}
    reached = {key: policy.returns(n) for key, policy in policies.items()}
    best = {
        task: max((key for key in jobs if jobs[key].task == task), key=lambda k: reached[k].mean()) for task in TASKS
    }
    plans_near_policies = make_plans(TASKS, n, finished, {task: policies[key] for task, key in best.items()})

    def collected(of: str) -> np.ndarray:
        return np.array(
            [[[one[of] for one in guess[task]] for guess in (shown, plans_near_policies)] for task in TASKS]
        )

    shape = (len(TASKS), len(METHODS), params.runs, n)
    dimensions = ("task", "guess", "start")
    return {
        "planned": (dimensions, collected("returned"), "1", "return of a plan"),
        "replayed": (dimensions, collected("replayed"), "1", "exact return of its inputs"),
        "certified": (dimensions, collected("certified"), "1", "whether it is certified"),
        "reached": (
            ("task", "algorithm", "run", "start"),
            np.reshape(list(reached.values()), shape),
            "1",
            "exact return of a policy over as many steps",
        ),
    }


def _job(task: str, method: Method, params: Params, run: int, shown: list[Curves]) -> TrainingJob:
    """Return a training job that runs for the budget of steps or, for MBPO, for a number of iterations."""
    seed = params.seed * 1000 + run
    start = fit_network(task, shown, seed) if method.shown else None
    length: dict[str, Any] = {"budget": Budget(1000 * params.kilosteps, params.judged)}
    if method.algorithm == "mbpo":
        every = max(1, params.model_based // params.judged)
        length = {"iterations": params.model_based, "evaluate_every": every}
    return make_job(
        task, method.algorithm, method.law, seed, hidden=method.hidden, episodes=EPISODES, start=start, **length
    )


STEPS = 20
"""Number of steps of a plan; longer plans would not be certified within minutes."""
_DEMONSTRATIONS = 8
"""Number of noisy copies of each state of a plan in the demonstrations."""
_DEMONSTRATION_SPREAD = 0.02
"""Standard deviation of the noise on the copies, in units of the characteristic sizes of the states."""
_START_SEED = 31
"""Random seed of the initial states of plans."""


@dataclass(frozen=True)
class Policy:
    """Learned policy of a task, with the widths of its hidden layers."""

    task: str
    trained: TrainedPolicy
    hidden: tuple[int, ...]

    def experiment(self, steps: int) -> Experiment:
        """Build the experiment that evaluates the policy over episodes of ``steps`` steps."""
        task = registry.get(self.task, horizon=steps)
        return Experiment(task=task, algorithm=FOPG(), hidden=self.hidden, threads=1)

    def returns(self, n: int) -> np.ndarray:
        """Return exact returns (n,) over as many steps as a plan has, from the plans' first ``n`` start states."""
        episodes = evaluate_from(self.experiment(STEPS), self.trained, EXACT, initial_states(self.task, n))
        return episodes.returns


@dataclass(frozen=True)
class PlanJob:
    """Job of one plan from start state ``number``; the guess has constant inputs or is the motion of ``near``."""

    task: str
    number: int
    near: Policy | None = None


def make_plan(job: PlanJob, _: Report) -> dict[str, np.ndarray]:
    """Plan from one start and return arrays (a :data:`~ocp.jobs.scheduling.Function`).

    ``states`` and ``inputs`` are demonstrations of the plan, ``returned`` is its return, ``replayed`` the
    return of its inputs under the exact law, and ``certified`` is true if the plan is certified.
    """
    task = registry.get(job.task, horizon=STEPS)
    x0 = initial_states(job.task, job.number + 1)[job.number]
    guess = guess_from_constant_inputs(task)
    if job.near is not None:
        guess = guess_from_policy(job.near.experiment(STEPS), job.near.trained)
    best = best_plan(task, x0, guess)
    states, inputs = demonstrations([best.solution], _DEMONSTRATIONS, _DEMONSTRATION_SPREAD, job.number)
    return {
        "states": states,
        "inputs": inputs,
        "returned": np.array(best.planned_return),
        "replayed": np.array(best.replayed_return),
        "certified": np.array(best.certified),
    }


def initial_states(task: str, n: int) -> np.ndarray:
    """Return the first ``n`` initial states (n, nx) of plans of a task."""
    task_object = registry.get(task)
    return np.concatenate([task_object.reset(1, np.random.default_rng([_START_SEED, number])) for number in range(n)])


def make_plans(
    tasks: tuple[str, ...], n: int, finished: FinishedParts, best: Mapping[str, Policy] | None = None
) -> dict[str, list[dict[str, np.ndarray]]]:
    """Compute ``n`` plans of each task in parallel, from guesses with constant inputs or motions of ``best``."""
    guess_kind = "plan" if best is None else "near"
    jobs = {
        f"{guess_kind}-{task}-{k}": PlanJob(task, k, None if best is None else best[task])
        for task in tasks
        for k in range(n)
    }
    results = side_by_side(make_plan, jobs, finished)
    return {task: [results[f"{guess_kind}-{task}-{k}"] for k in range(n)] for task in tasks}


def fit_network(task: str, shown: list[dict[str, np.ndarray]], seed: int) -> TrainedPolicy:
    """Return a policy network fitted to the demonstrations of the plans ``shown``."""
    states, inputs = (np.concatenate([plan_arrays[of] for plan_arrays in shown]) for of in ("states", "inputs"))
    return fit_actions(registry.get(task), states, inputs, HIDDEN, seed)
