"""Episodes of a task: its system closed by a law, under a policy, at parameters by name."""

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
from dynamics.batch.graphs.objective import DISCOUNT
from dynamics.contact import ContactLaw
from ocp.gradients.objective import without_warnings
from ocp.learning.protocol import Normaliser
from ocp.problem.task import Task


class TaskRollouts:
    """Returns of ``horizon`` steps of a task under a contact law, and their gradients.

    ``parameters`` are the task's, the law's (``contact.mu``), ``discount``, and ``mean[i]``
    and ``scale[i]`` of the observations where the policy normalises them. What the task gives at
    the end of an episode counts where ``horizon`` is a whole one.

    Raises ``ValueError`` where the law cannot close the system.
    """

    def __init__(self, task: Task, law: ContactLaw, policy: RolloutPolicy, horizon: int, **engine: Any) -> None:
        self.task, self.law, self.policy, self.horizon = task, law, policy, horizon
        step = law.close(replace(task.system, parameters=task.parameters))
        self.function = EpisodeFunction(step, episode_rewards(task, horizon), horizon, policy, **engine)
        self.parameters = self.function.parameters

    def over(self, horizon: int) -> TaskRollouts | None:
        """The same over another horizon, built and compiled once; None where that cannot be."""
        other = copy(self)
        other.horizon = horizon
        if _is_truncated(self.task, horizon) != _is_truncated(self.task, self.horizon):
            return None
        other.function = self.function.over(horizon)
        return other

    def __call__(
        self,
        x0: np.ndarray,
        theta: np.ndarray,
        normaliser: Normaliser | None = None,
        *,
        discount: float = 1.0,
        model_params: np.ndarray | None = None,
        **asked: Any,
    ) -> Episodes:
        """Episodes from ``x0`` (n, nx); ``asked`` as :class:`~dynamics.batch.EpisodeFunction`.

        ``model_params`` (np,) or (n, np) are the task's parameters, by default its own. Samples
        that could not be solved have no finite return, and are named by ``nonfinite``.
        """
        p = self._packed(normaliser, discount, model_params)
        return without_warnings(self.function, x0, theta, p, **asked)

    def moments(
        self,
        x0: np.ndarray,
        theta: np.ndarray,
        normaliser: Normaliser | None = None,
        **asked: Any,
    ) -> RolloutMoments:
        """Moments over samples, with nothing kept of single ones."""
        p = self._packed(normaliser, 1.0, None)
        return without_warnings(self.function.moments, x0, theta, p, **asked)

    def _packed(self, normaliser: Normaliser | None, discount: float, model_params: np.ndarray | None) -> np.ndarray:
        """Values of :attr:`parameters`, (np,), or (n, np) where they differ over samples."""
        own = self.task.parameters.values
        if model_params is not None:
            own = np.asarray(model_params, dtype=float)
        told = {DISCOUNT: discount}
        if normaliser is not None and isinstance(self.policy, DensePolicy):
            pairs = ("mean", normaliser.mean), ("scale", normaliser.scale)
            told |= {f"{name}[{i}]": v for name, of in pairs for i, v in enumerate(of.tolist())}
        whole = self.parameters.pack(told)
        rest = whole[own.shape[-1] :]
        if own.ndim == 1:
            return np.concatenate([own, rest])
        return np.hstack([own, np.broadcast_to(rest, (len(own), len(rest)))])


def episode_rewards(task: Task, horizon: int) -> Episode:
    """What counts over ``horizon`` steps: the end of an episode only where they are a whole one."""
    final = task.finals
    if _is_truncated(task, horizon):
        final = ca.Function("final", [task.system.x, task.parameters.vector], [ca.SX(0)])
    return Episode(task.rewards, final, task.ends)


def _is_truncated(task: Task, horizon: int) -> bool:
    """Whether an unroll ends before an episode does, and so without what is gained there."""
    return horizon != task.horizon and not ca.SX(task.final).is_zero()
