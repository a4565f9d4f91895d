"""First-order policy gradient: the gradient of the return through the contact model."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, ClassVar

from dynamics.contact import Barrier
from ocp.errors import choose
from ocp.learning.ascent import RULES, ascend
from ocp.learning.experiment import Experiment, at_least, positive
from ocp.learning.protocol import Row, State, Trained
from ocp.learning.starts import Starts
from ocp.learning.unrolling import (
    begun,
    finite,
    next_starts,
    remembered,
    roll,
    told,
    told_gradient,
    trained,
)

SHARP = Barrier(mu=1e-10)
"""What stands for exact contact where gradients are wanted (abs, sec. 7.4)."""

SMOOTHINGS = {"rollout": "states and gradient of the model's law", "gradient": "exact states"}


@dataclass(frozen=True, kw_only=True)
class FOPG:
    """``theta <- theta + rate g``, g the mean gradient of unrolled returns (abs, eq. 4.2, 4.3).

    ``samples`` unrolls of ``unroll`` steps, at most an episode's, with Gaussian noise of standard
    deviation ``sigma`` on the actions before tanh. With ``smoothing="rollout"`` states and gradient
    are those of the experiment's law; with ``"gradient"`` states are those of mu = 1e-10 and only
    the gradient along them is of the law (algorithm 2). ``optimiser`` is one of ``ascend``'s.
    """

    name: ClassVar[str] = "fopg"
    summary: ClassVar[str] = "first-order policy gradient through the contact model"

    samples: int = 64
    unroll: int = 32
    sigma: float = 0.1
    rate: float = 0.01
    optimiser: str = "adam"
    smoothing: str = "rollout"

    def settings(self) -> dict[str, Any]:
        """All of them."""
        return asdict(self)

    def begin(self, experiment: Experiment) -> State:
        """The first policy and a buffer of first states."""
        at_least(1, "samples", self.samples)
        at_least(1, "unroll", self.unroll)
        positive("sigma", self.sigma)
        positive("rate", self.rate)
        choose("optimiser", self.optimiser, RULES)
        choose("smoothing", self.smoothing, SMOOTHINGS)
        steps = unroll_of(experiment, self.unroll)
        return {
            **begun(experiment),
            **Starts.first(experiment, self.samples, steps).arrays(),
        }

    def iterate(self, experiment: Experiment, state: State, k: int) -> tuple[State, Row]:
        """One step along the mean gradient."""
        x0, steps = state["starts.x"], unroll_of(experiment, self.unroll)
        noise = experiment.noise(self.sigma, k, "actions")
        followed = None
        if self.smoothing == "gradient":
            followed = roll(experiment, state, x0, steps, law=SHARP, noise=noise)
        found = roll(experiment, state, x0, steps, noise=noise, gradient=True, along=followed)
        good = finite(experiment, state, found, k)
        assert found.gradient is not None
        gradients = found.gradient[good]
        lived = found if followed is None else followed
        changed = {
            **ascend(self.optimiser, state, gradients.mean(axis=0), self.rate),
            **remembered(experiment, state, lived, good),
            **next_starts(experiment, state, lived, k),
        }
        return changed, {**told(lived, good), **told_gradient(gradients)}

    def policy(self, experiment: Experiment, state: State) -> Trained:
        """The policy of the state."""
        return trained(state)


def unroll_of(experiment: Experiment, unroll: int) -> int:
    """Steps of an unroll, no more than an episode has."""
    return min(unroll, experiment.task.horizon)
