"""What algorithms that follow gradients of truncated unrolls have in common."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Annotated, Any, ClassVar

import numpy as np

from ocp.errors import InputError, choose
from ocp.learning.experiment import Experiment, at_least, positive
from ocp.learning.protocol import State, Trained
from ocp.learning.unrolls.ascent import RULES, ascend
from ocp.learning.unrolls.unrolling import Starts, initial_state, policy_of


@dataclass(frozen=True, kw_only=True)
class Unrolled:
    """Settings of an algorithm that unrolls a policy and steps along a gradient.

    ``samples`` unrolls of ``unroll`` steps, at most an episode's, from a buffer of states, with
    Gaussian noise of standard deviation ``sigma`` on the actions before tanh; steps of ``rate``
    by ``optimiser``, one of :func:`~ocp.learning.unrolls.ascent.ascend`'s.
    """

    samples: Annotated[int, "unrolls an iteration"] = 64
    unroll: Annotated[int, "steps of an unroll, at most an episode's"] = 32
    sigma: Annotated[float, "standard deviation of the noise on the actions before tanh"] = 0.1
    rate: Annotated[float, "length of a step of the optimiser"] = 0.01
    optimiser: Annotated[str, f"rule of a step: {', '.join(RULES)}"] = "adam"

    least: ClassVar[int] = 1
    """Samples that the estimate needs."""

    def settings(self) -> dict[str, Any]:
        """All of them."""
        return asdict(self)

    def check(self, experiment: Experiment) -> None:
        """Raise :class:`~ocp.errors.InputError` for settings that cannot be."""
        if self.samples == 1 < self.least:
            raise InputError(f"samples is 1, but a variance needs two; give at least {self.least}")
        at_least(self.least, "samples", self.samples)
        at_least(1, "unroll", self.unroll)
        positive("sigma", self.sigma)
        positive("rate", self.rate)
        choose("optimiser", self.optimiser, RULES)

    def starts(self) -> int:
        """States in the buffer."""
        return self.samples

    def steps(self, experiment: Experiment) -> int:
        """Steps of an unroll, no more than an episode has."""
        return min(self.unroll, experiment.task.horizon)

    def begin(self, experiment: Experiment) -> State:
        """The first policy and a buffer of first states."""
        self.check(experiment)
        starts = Starts.first(experiment, self.starts(), self.steps(experiment))
        return {**initial_state(experiment), **starts.arrays()}

    def policy(self, experiment: Experiment, state: State) -> Trained:
        """The policy of the state."""
        return policy_of(state)

    def climb(self, state: State, gradient: np.ndarray) -> State:
        """The state with a step along ``gradient`` (n_theta,) taken."""
        return ascend(self.optimiser, state, gradient, self.rate)


@dataclass(frozen=True, kw_only=True)
class Clipping(Unrolled):
    """Settings of one that may cut every sample's gradient to ``clip`` times their median length.

    Cutting biases the mean, whatever the estimate, and saves it from the few samples that lose
    their way; by default nothing is cut.
    """

    clip: Annotated[
        float | None, "a sample's longest gradient in median lengths of all, which biases the mean"
    ] = None

    def check(self, experiment: Experiment) -> None:
        """As all, and the length."""
        super().check(experiment)
        if self.clip is not None:
            positive("clip", self.clip)

    def clipped(self, gradients: np.ndarray) -> np.ndarray:
        """``gradients`` (n, n_theta), none longer than ``clip`` times their median length."""
        if self.clip is None:
            return gradients
        lengths = np.linalg.norm(gradients, axis=1)
        longest = self.clip * np.median(lengths)
        return gradients * np.minimum(1.0, longest / np.maximum(lengths, 1e-300))[:, None]
