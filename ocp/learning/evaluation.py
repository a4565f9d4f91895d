"""Policies judged: episodes under any contact law, without noise."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np

from dynamics.batch import BatchFunction, BatchWarning
from dynamics.contact import ContactLaw
from ocp.errors import InputError
from ocp.learning.experiment import Experiment, at_least
from ocp.learning.protocol import Trained
from ocp.learning.unrolls.unrolling import non_finite_reward
from ocp.task import Task

SEED = 1_000_000
"""Of the first states that policies are judged from, by default; training draws others."""


@dataclass(frozen=True)
class Evaluation:
    """Episodes of a policy: the sum of rewards ``returns`` (n,), undiscounted; steps ``lengths``
    (n,) until their end; ``measures``, of each the mean over an episode's steps (n,); ``states``
    (n, N+1, nx), the last one repeated after the end; ``inputs`` (n, N, nu), 0 after the end.

    ``unsolved`` (k, 2) are sample and step of the contacts that found no solution; their episode's
    return counts no further.
    """

    returns: np.ndarray
    lengths: np.ndarray
    measures: dict[str, np.ndarray]
    states: np.ndarray
    inputs: np.ndarray
    unsolved: np.ndarray

    def summary(self) -> dict[str, float]:
        """Means over the episodes, the spread of returns, and the share of steps unsolved."""
        steps = max(float(self.lengths.sum()), 1.0)
        return {
            "return": float(self.returns.mean()),
            "return_deviation": float(self.returns.std()),
            "length": float(self.lengths.mean()),
            **{name: float(values.mean()) for name, values in self.measures.items()},
            "unsolved": len(self.unsolved) / steps,
        }


def evaluate(
    experiment: Experiment,
    trained: Trained,
    law: ContactLaw,
    episodes: int = 100,
    seed: int = SEED,
) -> Evaluation:
    """Episodes of the policy at the task's own parameters, from first states out of ``seed``.

    Raises :class:`~ocp.errors.InputError` where a reward is not a number though states are, with
    step and episode.
    """
    at_least(1, "episodes", episodes)
    x0 = experiment.task.reset(episodes, np.random.default_rng(seed))
    return evaluate_from(experiment, trained, law, x0)


def evaluate_from(
    experiment: Experiment, trained: Trained, law: ContactLaw, x0: np.ndarray
) -> Evaluation:
    """As :func:`evaluate`, from first states ``x0`` (n, nx)."""
    found = experiment.rollouts(experiment.task.horizon, law)(
        x0, trained.theta, trained.normaliser, n_samples=len(x0), states=True
    )
    states, lived = found.states, found.lived.astype(int)
    task, (n, nodes) = experiment.task, states.shape[:2]
    steps = np.arange(nodes - 1)
    ok = np.isfinite(states[:, 1:]).all(axis=-1)
    reached = np.where(ok.all(axis=-1), nodes - 1, np.argmin(ok, axis=1))
    lost = np.flatnonzero(reached < lived)
    unsolved = np.column_stack([lost, reached[lost]])
    lengths = np.minimum(lived, reached)
    on = steps < lengths[:, None]
    inputs = np.zeros((n, nodes - 1, task.system.nu))
    inputs[on] = experiment.inputs(trained, states[:, :-1][on])
    at = states[:, :-1][on], inputs[on], states[:, 1:][on], task.parameters.values
    returns = np.zeros((n, nodes - 1))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BatchWarning)
        returns[on] = BatchFunction(task.rewards, "numpy", 1)(*at)[:, 0]
    lost = np.argwhere(~np.isfinite(returns))
    if len(lost):
        episode, step = lost[0].tolist()
        raise InputError(
            non_finite_reward(experiment, step, f"episode {episode} of the evaluation")
        )
    whole = lengths == nodes - 1
    ended = BatchFunction(task.ends, "numpy", 1)(states[whole, -1], task.parameters.values)
    total = returns.sum(axis=1)
    finals = BatchFunction(task.finals, "numpy", 1)(states[whole, -1], task.parameters.values)
    total[whole] += np.where(ended[:, 0] == 0, finals[:, 0], 0.0)
    return Evaluation(total, lengths, _measures(task, at, on, lengths), states, inputs, unsolved)


def _measures(
    task: Task, at: tuple[np.ndarray, ...], on: np.ndarray, lengths: np.ndarray
) -> dict[str, np.ndarray]:
    """Means of the task's measures over the steps of each episode that count, ``on`` (n, N)."""
    if not task.measures:
        return {}
    values = np.zeros((*on.shape, len(task.measures)))
    values[on] = BatchFunction(task.measure, "numpy", 1)(*at)
    means = values.sum(axis=1) / np.maximum(lengths, 1)[:, None]
    names = (measure.signal.name for measure in task.measures)
    return dict(zip(names, means.T, strict=True))
