"""What every algorithm that learns a policy keeps to."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from ocp.learning.network import Normaliser

if TYPE_CHECKING:
    from ocp.learning.experiment import Experiment

State = dict[str, np.ndarray]
"""All that an algorithm must remember from one iteration to the next, as a checkpoint stores it."""

Row = dict[str, float]
"""What is told of one iteration, by name. All tell ``return_mean`` (of the samples drawn), those
with gradients ``gradient_norm`` and ``gradient_variance`` (trace of the covariance of one sample's
gradient); the loop adds ``env_steps``, the simulated steps that it counted."""


class Trained(NamedTuple):
    """Parameters ``theta`` (n_theta,) of a policy, and what it has seen."""

    theta: np.ndarray
    normaliser: Normaliser

    @classmethod
    def of(cls, state: State) -> Trained:
        """The policy of an algorithm's state."""
        return cls(state["theta"], Normaliser.of(state))

    @property
    def digest(self) -> str:
        """Ten hex digits over all of it."""
        n, mean, m2 = self.normaliser.arrays().values()
        parts = (np.asarray(part, dtype=float) for part in (self.theta, n, mean, m2))
        return hashlib.sha256(b"".join(part.tobytes() for part in parts)).hexdigest()[:10]


class Algorithm:
    """One way to improve a policy; its attributes are its settings, frozen.

    The numbers of iteration k are drawn by :meth:`Experiment.rng` and :meth:`Experiment.noise` at
    k, so that a run that goes on from a stored state ends as one that was never stopped.
    """

    name: ClassVar[str]
    summary: ClassVar[str]
    contact: ClassVar[str]
    """Name of the contact law that it is meant to learn through."""

    def settings(self) -> dict[str, Any]:
        """What was chosen, for the run's record."""
        return dict(vars(self))

    def check(self, experiment: Experiment) -> None:
        """Raise :class:`~ocp.errors.InputError` where settings do not fit, before any work."""
        raise NotImplementedError

    def begin(self, experiment: Experiment) -> State:
        """State before the first iteration, the first policy; raises as :meth:`check` does."""
        self.check(experiment)
        normaliser = Normaliser.identity(len(experiment.task.observations))
        if experiment.start is not None:
            normaliser = experiment.start.normaliser
        return {"theta": experiment.first_theta(), **normaliser.arrays()}

    def iterate(self, experiment: Experiment, state: State, k: int) -> tuple[State, Row]:
        """State after iteration k, and what is told of it; ``state`` is left as it was."""
        raise NotImplementedError

    def policy(self, experiment: Experiment, state: State) -> Trained:
        """The policy as it is, without noise."""
        return Trained.of(state)


def prefixed(prefix: str, arrays: Mapping[str, Any]) -> State:
    """Entries named ``prefix`` and their own name."""
    return {prefix + name: value for name, value in arrays.items()}


def under(prefix: str, state: State) -> State:
    """The entries that :func:`prefixed` named, by their own names."""
    return {n.removeprefix(prefix): value for n, value in state.items() if n.startswith(prefix)}
