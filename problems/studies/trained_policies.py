"""A4: policies for machines, trained by seven algorithms and evaluated under the exact law."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr

from dynamics.contact import Adaptive, Barrier, ContactLaw
from ocp.jobs.scheduling import Report
from ocp.learning.experiment import EXACT, Budget, Experiment
from ocp.learning.imitation import demonstrations, fit_actions
from ocp.learning.planned import best_plan, guess_from_constant_inputs, guess_from_policy
from ocp.learning.protocol import Trained
from ocp.learning.training import evaluate_from
from ocp.learning.unroll_gradients import FOPG
from problems.studies.shared.trainings import (
    Curves,
    claim_gains,
    interpolate_finite,
    make_job,
    mean_difference,
    mean_height,
    side_by_side,
    training_curves,
)
from problems.studies.study import Claim, FinishedParts, StudyParams, claim, dataset, setting, settings_text
from problems.tasks import registry
from problems.tasks.training import TrainingJob, policy_of

NOTES = (
    "All curves are returns of whole episodes of 5 s under the exact law, without noise on the"
    " actions, linear between judgements.",
    "Every algorithm has its usual settings for the task, as ocp train has them, and learns"
    " until it has simulated the same number of steps. All steps count that are simulated to"
    " learn from, by whatever batch and under whatever law, until an episode ends; judgements"
    " count for none.",
    "MBPO, whose updates take most of a second for a hundred steps, cannot spend that number"
    " here. It has an axis of its own, steps of its random exploration included, and no claim"
    " compares it at equal steps. Total propagation stands for the paper's PIPPS: it is that"
    " without a learned model and without importance weights. What else is not as published is"
    " in the tables of docs/theory/policies.md.",
    "AoBG has gamma = 1, its default. Where its batch is too small for that, alpha is 0, as its"
    " source has it, and it is a zeroth-order gradient that pays for an unused first order.",
    "Policies are affine in normalised observations; MBPO and the two networks named so"
    " have two tanh layers of 32. The paper tells neither horizon, batch, rate nor network.",
    "Plans are of the first second of an episode, 20 steps, by direct transcription under the"
    " exact law, from inputs that are held, and from where the best policy leads. A certified"
    " plan is a local optimum of its own; nothing is planned for after its end.",
    "From plans: a network fitted to them, and to their feedback beside them, is where FOPG"
    " begins; the other network begins by chance.",
    "Wall time is that of this machine, one process a run, and depends on what else it does.",
)
QUICK = {"runs": 2, "kilosteps": 2, "model_based": 2, "judged": 2, "plans": 1}
RESUMES = True


TASKS = ("hopper", "half-cheetah")
"""Tasks that policies are trained on."""
POINTS = 60
"""Points along each axis of the returns."""
HIDDEN = (32, 32)
"""Layers of the networks that are trained and fitted to plans."""
EPISODES = 16
"""Episodes of each evaluation."""


@dataclass(frozen=True)
class Method:
    """An algorithm, the law that it learns through, and the layers of its policy."""

    algorithm: str
    law: ContactLaw
    hidden: tuple[int, ...] = ()
    shown: bool = False
    """Whether it begins at a policy fitted to plans."""


_SHARP_LAW = Barrier(mu=1e-10)
"""Law that stands for the exact one in gradients."""
_ABS_LAW = Adaptive("quartic")
"""The paper's adaptive law."""
NETWORK = "FOPG-ABS, network"
"""Method whose network begins at random weights."""
SHOWN = "the same, from plans"
"""Method whose network begins at plans."""
MODEL_BASED = "MBPO"
"""Method with iterations instead of the budget: its updates a step take too long."""
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
"""All methods, in the order of the data."""


class Params(StudyParams):
    """Parameters of A4; the paper states only the number of seeds."""

    runs: int = setting(5, "1", "seeds of each algorithm and task", least=2)
    kilosteps: int = setting(200, "1", "thousand simulated steps of each run", least=1)
    model_based: int = setting(16, "1", "iterations of MBPO instead", least=2)
    judged: int = setting(20, "1", "judgements along a run", least=2)
    plans: int = setting(4, "1", "starts that episodes are planned from", least=1)


def run(params: Params, pieces: FinishedParts) -> xr.Dataset:
    """Compute returns of every run over simulated steps and over time, and the best policy's motion."""
    plans_shown = make_plans(TASKS, params.plans, pieces)
    jobs = {
        f"{task}-{name}-{r}": _job(task, METHODS[name], params, r, plans_shown[task])
        for task in TASKS
        for name in METHODS
        for r in range(params.runs)
    }
    trainings = training_curves(jobs, pieces)
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
            **_against_plans(params, pieces, plans_shown, jobs, trainings),
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
    pieces: FinishedParts,
    shown: Mapping[str, list[Curves]],
    jobs: Mapping[str, TrainingJob],
    trainings: Mapping[str, Curves],
) -> dict[str, Any]:
    """Compute returns over as many steps as a plan has: of both kinds of plans, and of every policy."""
    n = params.plans
    policies = {key: Policy(job.task, policy_of(trainings[key]), job.options["hidden"]) for key, job in jobs.items()}
    reached = {key: policy.returns(n) for key, policy in policies.items()}
    best = {
        task: max((key for key in jobs if jobs[key].task == task), key=lambda k: reached[k].mean()) for task in TASKS
    }
    plans_near_policies = make_plans(TASKS, n, pieces, {task: policies[key] for task, key in best.items()})

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
    """Build a training that spends the budget, or MBPO's iterations."""
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
"""Steps of a plan: longer ones are not certified in minutes."""
_DEMONSTRATIONS = 8
"""Copies of each state of a plan in the demonstrations."""
_DEMONSTRATION_SPREAD = 0.02
"""Normal noise on the copies, in characteristic sizes."""
_START_SEED = 31
"""Seed of the states that plans start from."""


@dataclass(frozen=True)
class Policy:
    """Learned policy of a task, with the sizes of its layers."""

    task: str
    trained: Trained
    hidden: tuple[int, ...]

    def over(self, steps: int) -> Experiment:
        """Build the experiment that evaluates the policy over ``steps``."""
        task = registry.get(self.task, horizon=steps)
        return Experiment(task=task, algorithm=FOPG(), hidden=self.hidden, threads=1)

    def returns(self, n: int) -> np.ndarray:
        """Compute returns (n,) over as many steps as a plan has, from the plans' starts."""
        episodes = evaluate_from(self.over(STEPS), self.trained, EXACT, initial_states(self.task, n))
        return episodes.returns


@dataclass(frozen=True)
class PlanJob:
    """Plan from the ``number``-th start, guessed from constant inputs or from a policy's motion."""

    task: str
    number: int
    near: Policy | None = None


def make_plan(job: PlanJob, _: Report) -> dict[str, np.ndarray]:
    """Plan one start; a :data:`~ocp.jobs.scheduling.Function`.

    ``states`` and ``inputs`` are what the plan shows, ``returned`` and ``replayed`` its return and
    that of its inputs under the exact law, ``certified`` whether it is.
    """
    task = registry.get(job.task, horizon=STEPS)
    x0 = initial_states(job.task, job.number + 1)[job.number]
    guess = guess_from_constant_inputs(task)
    if job.near is not None:
        guess = guess_from_policy(job.near.over(STEPS), job.near.trained)
    best = best_plan(task, x0, guess)
    states, inputs = demonstrations([best.solution], _DEMONSTRATIONS, _DEMONSTRATION_SPREAD, job.number)
    return {
        "states": states,
        "inputs": inputs,
        "returned": np.array(best.returned),
        "replayed": np.array(best.replayed),
        "certified": np.array(best.certified),
    }


def initial_states(task: str, n: int) -> np.ndarray:
    """Return the first ``n`` states that plans start from (n, nx)."""
    task_object = registry.get(task)
    return np.concatenate([task_object.reset(1, np.random.default_rng([_START_SEED, number])) for number in range(n)])


def make_plans(
    tasks: tuple[str, ...], n: int, pieces: FinishedParts, best: Mapping[str, Policy] | None = None
) -> dict[str, list[dict[str, np.ndarray]]]:
    """Compute ``n`` plans of each task, side by side, from constant inputs or ``best`` policies."""
    word = "plan" if best is None else "near"
    jobs = {
        f"{word}-{task}-{k}": PlanJob(task, k, None if best is None else best[task]) for task in tasks for k in range(n)
    }
    results = side_by_side(make_plan, jobs, pieces)
    return {task: [results[f"{word}-{task}-{k}"] for k in range(n)] for task in tasks}


def fit_network(task: str, shown: list[dict[str, np.ndarray]], seed: int) -> Trained:
    """Fit a network to plans."""
    states, inputs = (np.concatenate([plan_arrays[of] for plan_arrays in shown]) for of in ("states", "inputs"))
    return fit_actions(registry.get(task), states, inputs, HIDDEN, seed)


_EQUAL_RETURN = 1e-2
"""Relative difference up to which a plan and its replay have one return."""
_PLACE = "ABS, sec. 7.3, fig. 4"
"""Source of the claims of the paper."""
_OURS = "FOPG-ABS"
"""The paper's own method."""
_RUNNING_SPEEDS = {"hopper": 1.0, "half-cheetah": 1.5}
"""Least mean forward speed of a policy that runs [m/s]."""


def claims(data: xr.Dataset) -> list[Claim]:
    """Return claims on FOPG with ABS, on policies that run, and on plans."""
    papers = [str(name) for name in data["algorithm"].values if name not in (NETWORK, SHOWN)]
    others = [name for name in papers if name not in (_OURS, MODEL_BASED)]
    results = []
    for task in map(str, data["task"].values):
        results += _of_plans(task, data.sel(task=task))
        task_data = data.sel(task=task, algorithm=papers)
        areas = {n: mean_height(task_data["by_steps"].sel(algorithm=n).values) for n in (_OURS, *others)}
        gains = [mean_difference(areas[_OURS], areas[name], paired=False) for name in others]
        best = {n: task_data["best"].sel(algorithm=n).values for n in papers}
        ends = [mean_difference(best[_OURS], best[name], paired=False) for name in others]
        rivalry = [
            claim_gains(
                f"On {task} FOPG with ABS learns the fastest",
                _PLACE,
                "mean return over equal simulated steps above every other's, bootstrap 95 %",
                others,
                gains,
            ),
            claim_gains(
                f"On {task} FOPG with ABS ends the highest",
                _PLACE,
                "best return in equal simulated steps above every other's, bootstrap 95 %",
                others,
                ends,
            ),
        ]
        untrained_text = _untrained(task_data)
        results += [replace(claim, measured=claim.measured + untrained_text) for claim in rivalry]
        running = task_data["speed"].median("run").values >= _RUNNING_SPEEDS[task]
        lasting = task_data["length"].median("run").values >= 100
        speeds = ", ".join(f"{s:.2f}" for s in task_data["speed"].median("run").values)
        results.append(
            claim(f"Every algorithm's best policy runs on {task}", "our check")
            .expected(f"half of the seeds at {_RUNNING_SPEEDS[task]:g} m/s or more for 5 s, without falling")
            .measured(f"{settings_text(papers, running & lasting)}: {speeds} m/s")
            .holds(running & lasting)
        )
    return results


def _untrained(task_data: xr.Dataset) -> str:
    """Name the algorithms whose best policy is the initial one in every run."""
    initial = (task_data["best"] <= task_data["by_steps"].isel(steps=0)).all("run")
    names = ", ".join(map(str, task_data["algorithm"].values[initial.values]))
    return f"; never above their initial policy: {names}" if names else ""


def _of_plans(task: str, task_data: xr.Dataset) -> list[Claim]:
    """Check plans as a start to learn from, and as a measure of policies."""
    areas = [mean_height(task_data["by_steps"].sel(algorithm=name).values) for name in (SHOWN, NETWORK)]
    gain = mean_difference(*areas, paired=False)
    best = task_data["replayed"].max("guess")
    shares = task_data["reached"].median("run").mean("start") / best.mean("start")
    names = [str(name) for name in task_data["algorithm"].values]
    share_texts = ", ".join(f"{name} {share:.0%}" for name, share in zip(names, shares.values, strict=True))
    certified = task_data["certified"].astype(bool)
    replays_differently = abs(task_data["planned"] - task_data["replayed"]) > _EQUAL_RETURN * abs(task_data["replayed"])
    return [
        claim(f"On {task} a network begun at plans learns faster than one by chance", "our check")
        .expected("mean return over equal simulated steps above, bootstrap 95 %")
        .measured(str(gain))
        .holds(gain.better, margin=gain.margin),
        claim(f"On {task} no policy is above the best plan found from the same starts", "our check")
        .expected(f"share of the best plan's exact return over {STEPS} steps at most 100 %")
        .measured(
            f"{share_texts}; of {certified.size} plans {int(certified.sum())} certified,"
            f" {int((certified & replays_differently).sum())} of these replay to another return"
        )
        .at_most(shares, 1),
    ]
