"""Plans of an episode's beginning: what policies are fitted to, and what they are measured by."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ocp.learning.evaluation import evaluate_from
from ocp.learning.experiment import EXACT, Experiment
from ocp.learning.plans.demonstrations import demonstrations
from ocp.learning.plans.guesses import by_held_inputs, by_policy
from ocp.learning.plans.imitation import fitted_to
from ocp.learning.plans.planned import planned_return
from ocp.learning.protocol import Trained
from ocp.learning.unrolls.fopg import FOPG
from ocp.scheduling import Tell
from problems.studies.shared.trainings import side_by_side
from problems.studies.study import Pieces
from problems.tasks import registry

STEPS = 20
"""Of a plan: longer ones are not certified in minutes."""
HIDDEN = (32, 32)
_COPIES, _SPREAD = 8, 0.02
_STARTS = 31
"""Seed of the states that plans start from."""


@dataclass(frozen=True)
class Policy:
    """A learned policy of a task, with the sizes of its layers."""

    task: str
    trained: Trained
    hidden: tuple[int, ...]

    def over(self, steps: int) -> Experiment:
        """The experiment to judge it in, whatever made it."""
        task = registry.get(self.task, horizon=steps)
        return Experiment(task=task, algorithm=FOPG(), hidden=self.hidden, threads=1)

    def returns(self, n: int) -> np.ndarray:
        """Returns (n,) over as many steps as a plan has, from the plans' starts."""
        found = evaluate_from(self.over(STEPS), self.trained, EXACT, starts(self.task, n))
        return found.returns


@dataclass(frozen=True)
class PlanJob:
    """A plan from the ``number``-th start, out of held inputs, or where a policy leads."""

    task: str
    number: int
    near: Policy | None = None


def plan(job: PlanJob, _: Tell) -> dict[str, np.ndarray]:
    """Do a job; a :data:`~ocp.scheduling.Function`.

    ``states`` and ``inputs`` are what the plan shows, ``returned`` and ``replayed`` its return and
    that of its inputs under the exact law, ``certified`` whether it is.
    """
    task = registry.get(job.task, horizon=STEPS)
    x0 = starts(job.task, job.number + 1)[job.number]
    guess = by_held_inputs(task)
    if job.near is not None:
        guess = by_policy(job.near.over(STEPS), job.near.trained)
    found = planned_return(task, x0, guess)
    states, inputs = demonstrations([found.solution], _COPIES, _SPREAD, job.number)
    return {
        "states": states,
        "inputs": inputs,
        "returned": np.array(found.returned),
        "replayed": np.array(found.replayed),
        "certified": np.array(found.certified),
    }


def starts(task: str, n: int) -> np.ndarray:
    """The first ``n`` states that plans start from (n, nx)."""
    made = registry.get(task)
    return np.concatenate(
        [made.reset(1, np.random.default_rng([_STARTS, number])) for number in range(n)]
    )


def plans(
    tasks: tuple[str, ...], n: int, pieces: Pieces, best: Mapping[str, Policy] | None = None
) -> dict[str, list[dict[str, np.ndarray]]]:
    """``n`` plans of each task, side by side, from held inputs or where ``best`` policies lead."""
    word = "plan" if best is None else "near"
    jobs = {
        f"{word}-{task}-{k}": PlanJob(task, k, None if best is None else best[task])
        for task in tasks for k in range(n)
    }  # fmt: skip
    found = side_by_side(plan, jobs, pieces)
    return {task: [found[f"{word}-{task}-{k}"] for k in range(n)] for task in tasks}


def fitted(task: str, shown: list[dict[str, np.ndarray]], seed: int) -> Trained:
    """The network that does what plans show."""
    states, inputs = (np.concatenate([one[of] for one in shown]) for of in ("states", "inputs"))
    return fitted_to(registry.get(task), states, inputs, HIDDEN, seed)
