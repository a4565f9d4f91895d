"""First-order policy gradient: the gradient of the return through the contact model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from dynamics.contact import Barrier
from ocp.errors import choose
from ocp.learning.experiment import Experiment, at_least
from ocp.learning.protocol import Row, State
from ocp.learning.unrolls.critic import Critic
from ocp.learning.unrolls.unrolling import Clipping, finite_samples, roll

SHARP = Barrier(mu=1e-10)
"""What stands for exact contact where gradients are wanted (abs, sec. 7.4)."""

SMOOTHINGS = {
    "rollout": "states and gradient of the experiment's law",
    "gradient": "states of mu = 1e-10, and the gradient along them of the experiment's law",
}


@dataclass(frozen=True, kw_only=True)
class FOPG(Clipping):
    """``theta <- theta + rate g``, g the mean gradient of unrolled returns (abs, eq. 4.2, 4.3).

    With ``smoothing="rollout"`` states and gradient are those of the experiment's law; with
    ``"gradient"`` states are those of mu = 1e-10 and only the gradient along them is of the law
    (algorithm 2). With a ``critic`` of that many units in each layer, the value that it gives the
    last state of an unroll is gained there (:class:`~ocp.learning.unrolls.critic.Critic`).
    """

    name: ClassVar[str] = "fopg"
    summary: ClassVar[str] = "first-order policy gradient through the contact model"
    contact: ClassVar[str] = "adaptive"

    smoothing: Annotated[
        str, "rollout: states and gradient are the law's; gradient: the gradient alone"
    ] = "rollout"
    critic: Annotated[int, "units in each layer of a critic; 0 for none"] = 0

    @property
    def valued(self) -> Critic | None:
        """The critic, if there is one."""
        return Critic(units=self.critic) if self.critic else None

    def check(self, experiment: Experiment) -> None:
        """As all, and the smoothing, and whether there is something for a critic."""
        super().check(experiment)
        choose("smoothing", self.smoothing, SMOOTHINGS)
        at_least(0, "critic", self.critic)
        if critic := self.valued:
            critic.check(experiment, self.steps(experiment))

    def begin(self, experiment: Experiment) -> State:
        """As all, and the critic's network."""
        state, critic = super().begin(experiment), self.valued
        return {**state, **critic.begin(experiment)} if critic else state

    def iterate(self, experiment: Experiment, state: State, k: int) -> tuple[State, Row]:
        """One step along the mean gradient."""
        x0, steps, critic = state["starts.x"], self.steps(experiment), self.valued
        noise = experiment.noise(self.sigma, k, "actions")
        followed = pull = None
        if self.smoothing == "gradient":
            followed = roll(experiment, state, x0, steps, law=SHARP, noise=noise)
        if critic:
            reached = followed or roll(experiment, state, x0, steps, noise=noise)
            pull = critic.pull(experiment, state, reached)
        found = roll(
            experiment, state, x0, steps, noise=noise, gradient=True, along=followed, pull=pull
        )
        good = finite_samples(experiment, state, found, k)
        assert found.gradient is not None
        gradients = self.clipped(found.gradient[good])
        visited = found if followed is None else followed
        changed, row = self.stepped(experiment, state, gradients, visited, good, k)
        if critic:
            learned, more = critic.learned(experiment, state, changed, visited, noise, k)
            changed, row = {**changed, **learned}, {**row, **more}
        return changed, row
