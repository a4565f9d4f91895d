"""Where a search for a plan begins: what a policy does, the best of held inputs, a glide."""

from __future__ import annotations

import numpy as np

from dynamics.batch import constant
from ocp.learning.evaluation import evaluate_from
from ocp.learning.experiment import EXACT, Experiment
from ocp.learning.protocol import Trained
from ocp.learning.rollouts import TaskRollouts
from ocp.problem import Guess, Problem
from ocp.task import Task


def guess_from_policy(experiment: Experiment, trained: Trained) -> Guess:
    """The states and inputs of a policy's episode under the exact law.

    Where it ends early its last state stays, with inputs of zero.
    """

    def guess(problem: Problem, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        found = evaluate_from(experiment, trained, EXACT, problem.initial_states(p))
        return _hold_last_state(found.states[0]), found.inputs[0]

    return guess


def guess_from_constant_inputs(task: Task, n: int = 64, seed: int = 0) -> Guess:
    """The best of ``n`` inputs drawn between the bounds, each held throughout, in the exact law."""

    def guess(problem: Problem, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        share = np.random.default_rng(seed).uniform(-1.0, 1.0, (n, task.system.nu))
        policy = constant(task.system.nx, task.lower, task.upper)
        rollouts = TaskRollouts(task, EXACT, policy, task.horizon)
        start = np.repeat(problem.initial_states(p), n, axis=0)
        found = rollouts(start, np.arctanh(share), n_samples=n, model_params=p, states=True)
        best = int(np.argmax(np.where(np.isfinite(found.value), found.value, -np.inf)))
        held = (task.upper + task.lower) / 2 + share[best] * (task.upper - task.lower) / 2
        return _hold_last_state(found.states[best]), np.tile(held, (problem.N, 1))

    return guess


def straight_line_guess(first: np.ndarray, last: np.ndarray) -> Guess:
    """The straight way from state ``first`` to ``last``, each (nx,), with the middle inputs."""

    def guess(problem: Problem, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        low, high = (np.array(end).ravel() for end in problem.limits(p)[2:4])
        states = np.linspace(first, last, problem.N + 1)
        states[0] = problem.initial_states(p)[0]
        return states, np.tile((low + high) / 2, (problem.N, 1))

    return guess


def _hold_last_state(states: np.ndarray) -> np.ndarray:
    """``states`` (N+1, nx), the last one that is a number in place of those after it."""
    good = np.isfinite(states).all(axis=1)
    last = len(states) - 1 if good.all() else int(np.argmin(good)) - 1
    return states[np.minimum(np.arange(len(states)), last)]
