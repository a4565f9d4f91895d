"""Simulated episodes of a task under a contact law and a policy, with their returns and gradients."""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from dynamics.batch import (
    DensePolicy,
    Episode,
    EpisodeFunction,
    Episodes,
    RolloutMoments,
    RolloutPolicy,
)
from dynamics.batch.graphs.objective import DISCOUNT_NAME
from dynamics.contact import ContactLaw
from ocp.gradients.objective import without_warnings
from ocp.learning.protocol import Normaliser
from ocp.problem.task import Task


class TaskRollouts:
    """Compiled rollouts of ``horizon`` steps of a task under a contact law and a policy.

    ``parameters`` consists of the task's parameters, the law's parameters (such as ``contact.mu``), ``discount``, and
    ``mean[i]`` and ``scale[i]`` of each observation if the policy normalises observations. The final reward is
    included only if ``horizon`` is the task's horizon.

    Raises ``ValueError`` if the law cannot close the system.
    """

    def __init__(self, task: Task, law: ContactLaw, policy: RolloutPolicy, horizon: int, **engine: Any) -> None:
        self.task, self.law, self.policy, self.horizon = task, law, policy, horizon
        step = law.close(replace(task.system, parameters=task.parameters))
        self.function = EpisodeFunction(step, episode_rewards(task, horizon), horizon, policy, **engine)
        self.parameters = self.function.parameters

    def with_horizon(self, horizon: int) -> TaskRollouts | None:
        """Return rollouts with another horizon without recompiling; None if only one has the final reward."""
        extended = copy(self)
        extended.horizon = horizon
        if _is_truncated(self.task, horizon) != _is_truncated(self.task, self.horizon):
            return None
        extended.function = self.function.with_horizon(horizon)
        return extended

    def __call__(
        self,
        x0: np.ndarray,
        theta: np.ndarray,
        normaliser: Normaliser | None = None,
        *,
        discount: float = 1.0,
        model_params: np.ndarray | None = None,
        **options: Any,
    ) -> Episodes:
        """Simulate episodes from ``x0`` (n, nx); ``options`` as for :class:`~dynamics.batch.EpisodeFunction`.

        ``model_params`` (np,) or (n, np) replace the values of the task's parameters. Samples with an unsolved
        step have no finite return and are listed in the result's ``nonfinite``.
        """
        p = self._pack_parameters(normaliser, discount, model_params)
        return without_warnings(self.function, x0, theta, p, **options)

    def moments(
        self,
        x0: np.ndarray,
        theta: np.ndarray,
        normaliser: Normaliser | None = None,
        **options: Any,
    ) -> RolloutMoments:
        """Return the moments of the samples' returns and gradients, without storing each sample."""
        p = self._pack_parameters(normaliser, 1.0, None)
        return without_warnings(self.function.moments, x0, theta, p, **options)

    def _pack_parameters(
        self, normaliser: Normaliser | None, discount: float, model_params: np.ndarray | None
    ) -> np.ndarray:
        """Return the values of :attr:`parameters` as an array (np,), or (n, np) if they differ between samples."""
        task_parameters = self.task.parameters.values
        if model_params is not None:
            task_parameters = np.asarray(model_params, dtype=float)
        law_values = {DISCOUNT_NAME: discount}
        if normaliser is not None and isinstance(self.policy, DensePolicy):
            pairs = ("mean", normaliser.mean), ("scale", normaliser.scale)
            law_values |= {f"{name}[{i}]": v for name, statistics in pairs for i, v in enumerate(statistics.tolist())}
        all_parameters = self.parameters.pack(law_values)
        other_parameters = all_parameters[task_parameters.shape[-1] :]
        if task_parameters.ndim == 1:
            return np.concatenate([task_parameters, other_parameters])
        return np.hstack(
            [task_parameters, np.broadcast_to(other_parameters, (len(task_parameters), len(other_parameters)))]
        )


def episode_rewards(task: Task, horizon: int) -> Episode:
    """Return the reward functions of an unroll of ``horizon`` steps; only a whole episode has a final reward."""
    final = task.finals
    if _is_truncated(task, horizon):
        final = ca.Function("final", [task.system.x, task.parameters.vector], [ca.SX(0)])
    return Episode(task.rewards, final, task.ends)


def _is_truncated(task: Task, horizon: int) -> bool:
    """Return whether an unroll of ``horizon`` steps lacks the final reward, since the episode is longer."""
    return horizon != task.horizon and not ca.SX(task.final).is_zero()
