"""Episodes of a task: its system closed by a law, under a policy, at parameters by name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from dynamics.batch import (
    DensePolicy,
    Episode,
    EpisodeFunction,
    EpisodeMoments,
    Episodes,
    Gaussian,
    RolloutPolicy,
    constant,
    dense,
)
from dynamics.contact import ContactLaw
from ocp.gradients.objective import quietly
from ocp.task import Task


@dataclass(frozen=True)
class Normaliser:
    """What observations are normalised by, ``(o - mean) / scale``; both (n_o,)."""

    mean: np.ndarray
    scale: np.ndarray

    @classmethod
    def none(cls, n: int) -> Normaliser:
        """Leave n observations as they are."""
        return cls(np.zeros(n), np.ones(n))


def policy_of(task: Task, hidden: Sequence[int] | None) -> RolloutPolicy:
    """A policy with these hidden layers, () an affine one, None the same inputs at every step."""
    if hidden is None:
        return constant(task.system.nx, task.lower, task.upper)
    return dense(task.observe, hidden, task.lower, task.upper)


class TaskRollouts:
    """Returns of ``horizon`` steps of a task under a contact law, and their gradients.

    ``parameters`` are the task's, the law's knobs (``contact.mu``), ``discount``, and ``mean[i]``
    and ``scale[i]`` of the observations where the policy normalises them. What the task gives at
    the end of an episode counts where ``horizon`` is a whole one.

    Raises ``ValueError`` where the law cannot close the system.
    """

    def __init__(
        self, task: Task, law: ContactLaw, policy: RolloutPolicy, horizon: int, **engine: Any
    ) -> None:
        self.task, self.law, self.policy, self.horizon = task, law, policy, horizon
        step = law.close(replace(task.system, parameters=task.parameters))
        final = task.finals
        if horizon != task.horizon:
            arguments = [task.system.x, task.parameters.vector]
            final = ca.Function("final", arguments, [ca.SX(0)])
        episode = Episode(task.rewards, final, task.ends)
        self.function = EpisodeFunction(step, episode, horizon, policy, **engine)
        self.parameters = self.function.parameters

    def __call__(
        self,
        x0: np.ndarray,
        theta: np.ndarray,
        *,
        values: Mapping[str, ArrayLike] | None = None,
        normaliser: Normaliser | None = None,
        noise: Gaussian | np.ndarray | None = None,
        **asked: Any,
    ) -> Episodes:
        """Episodes from ``x0`` (n, nx); ``asked`` as :class:`~dynamics.batch.EpisodeFunction`.

        ``values`` are parameters by name, a number or (n,); those not named keep their default.
        Samples that could not be solved have no finite return, and are named by ``nonfinite``.
        """
        p = self.pack(values, normaliser)
        return quietly(self.function, x0, theta, p, noise, len(x0), **asked)

    def moments(
        self,
        x0: np.ndarray,
        theta: np.ndarray,
        *,
        values: Mapping[str, ArrayLike] | None = None,
        normaliser: Normaliser | None = None,
        noise: Gaussian | np.ndarray | None = None,
        **asked: Any,
    ) -> EpisodeMoments:
        """Moments over samples, with nothing kept of single ones but the steps they lived."""
        p = self.pack(values, normaliser)
        return quietly(self.function.moments, x0, theta, p, noise, len(x0), **asked)

    def pack(
        self, values: Mapping[str, ArrayLike] | None, normaliser: Normaliser | None
    ) -> np.ndarray:
        """Values of :attr:`parameters`, (np,), or (n, np) where one differs over samples."""
        told: dict[str, ArrayLike] = dict(values or {})
        if normaliser is not None and isinstance(self.policy, DensePolicy):
            pairs = ("mean", normaliser.mean), ("scale", normaliser.scale)
            told |= {f"{name}[{i}]": v for name, of in pairs for i, v in enumerate(of.tolist())}
        return self.parameters.pack(told)
