"""Model-based policy optimisation: a soft actor-critic on a model's short branches."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, ClassVar

from ocp.errors import InputError
from ocp.learning.experiment import Experiment, at_least, positive
from ocp.learning.protocol import Algorithm, Row, State, Trained

if TYPE_CHECKING:
    from ocp.learning.mbpo_training import MBPOTrainer


@dataclass(frozen=True, kw_only=True)
class MBPO(Algorithm):
    """Janner, Fu, Zhang and Levine, When to trust your model, 2019, algorithm 2.

    In every iteration ``walkers`` episodes go ``steps`` steps on under the exact law, whatever law
    the experiment has, with actions of the policy and its noise (in iteration 0 of random policies,
    ``explored`` steps); the ensemble is fitted on all steps seen, of which ``held_out`` choose its
    ``elites``; ``branches`` of it start at states seen, first ``shortest`` steps long, later
    ``longest`` (from half of the iterations on); and the actor-critic is updated ``updates`` times
    on batches of which the part ``real`` is of steps seen, the rest of branches, those of the last
    ``kept`` iterations. Reward and end of a step of the model are the task's own, but the critics
    are told rewards cut to at most ``cut`` in size, for one good step before a fall is none to
    learn from. Actions before tanh start with deviation ``sigma``, the temperature with ``alpha``,
    which keeps the entropy at ``aim`` an input: for a Gaussian well within the bounds, of deviation
    s in half ranges, 1.42 + ln s.

    The policy is the experiment's: tanh layers on observations, normalised once by the explored
    steps. ``critic_discount`` times the experiment's discount is the critics'. Sizes are for two
    cores; Janner's are 4 x 200 units, 256 in a batch, 400 branches and 20 to 40 updates a step.
    """

    name: ClassVar[str] = "mbpo"
    summary: ClassVar[str] = "soft actor-critic on short branches of a network ensemble"
    contact: ClassVar[str] = "exact"

    walkers: Annotated[int, "episodes continued under the exact law in each iteration"] = 16
    steps: Annotated[int, "steps of each continued episode"] = 16
    explored: Annotated[int, "steps of random policies in iteration 0"] = 2048
    capacity: Annotated[int, "steps that are kept"] = 100_000
    members: Annotated[int, "networks of the ensemble"] = 7
    elites: Annotated[int, "networks used: the elites"] = 5
    model_units: Annotated[int, "units of a layer of the model"] = 100
    model_layers: Annotated[int, "its layers"] = 3
    model_rate: Annotated[float, "learning rate of the model"] = 1e-3
    model_steps: Annotated[int, "gradient steps of the model per iteration"] = 200
    model_batch: Annotated[int, "batch size of the model"] = 128
    held_out: Annotated[float, "share of the transitions that selects the elites"] = 0.1
    branches: Annotated[int, "model branches per iteration"] = 400
    shortest: Annotated[int, "branch length in the first half of the iterations"] = 1
    longest: Annotated[int, "branch length in the second half"] = 5
    kept: Annotated[int, "iterations whose branches are kept for learning"] = 10
    critic_units: Annotated[int, "units of a layer of the critics"] = 128
    critic_layers: Annotated[int, "their layers"] = 2
    rate: Annotated[float, "learning rate of actor, critics and temperature"] = 3e-4
    sigma: Annotated[float, "initial standard deviation of the actions before tanh"] = 0.3
    alpha: Annotated[float, "initial entropy temperature"] = 0.1
    aim: Annotated[float, "target entropy per input"] = -1.0
    cut: Annotated[float, "largest absolute reward given to the critics"] = math.inf
    critic_discount: Annotated[float, "factor on the experiment's discount for the critics"] = 0.99
    slow: Annotated[float, "step of the target critics toward the critics"] = 0.005
    updates: Annotated[int, "updates of actor and critics per iteration"] = 1000
    batch: Annotated[int, "batch size of an update"] = 128
    real: Annotated[float, "share of real transitions in a batch"] = 0.05

    def begin(self, experiment: Experiment) -> State:
        """Networks out of the seed, and the steps explored.

        Raises :class:`~ocp.errors.InputError` where settings do not fit, and where the extra
        ``learn`` is not installed.
        """
        self.check(experiment)
        return self._trainer(experiment).initial_state()

    def iterate(self, experiment: Experiment, state: State, k: int) -> tuple[State, Row]:
        """Steps under the exact law, then of the ensemble, its branches, and the actor-critic."""
        return self._trainer(experiment).iterate(state, k)

    def policy(self, experiment: Experiment, state: State) -> Trained:
        """The mean action."""
        return self._trainer(experiment).policy(state)

    def check(self, experiment: Experiment) -> None:
        """Raise :class:`~ocp.errors.InputError` where settings do not fit."""
        if experiment.hidden is None:
            raise InputError(
                f"mbpo learns a policy that observes, and {experiment.task.name} has one constant"
                " input here; give it hidden layers"
            )
        if experiment.start is not None:
            raise InputError("mbpo learns networks of its own and cannot start from a policy; leave start out")
        whole = "walkers steps explored members elites model_units model_layers model_steps"
        whole += " model_batch branches shortest kept critic_units critic_layers updates batch"
        for name in whole.split():
            at_least(1, name, getattr(self, name))
        for name in ("model_rate", "rate", "alpha", "sigma"):
            positive(name, getattr(self, name))
        for name, (low, high) in {
            "elites": (1, self.members),
            "longest": (self.shortest, 1000),
            "aim": (-10.0, 0.6),
            "held_out": (0.01, 0.5),
            "cut": (1e-9, math.inf),
            "real": (0, 1),
            "critic_discount": (0, 1),
            "slow": (0, 1),
            "capacity": (self.explored, 10_000_000),
        }.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise InputError(f"{name} must be between {low:g} and {high:g}, got {value!r}")

    def _trainer(self, experiment: Experiment) -> MBPOTrainer:
        return experiment.cached(self._make_trainer)

    def _make_trainer(self, experiment: Experiment) -> MBPOTrainer:
        try:
            from ocp.learning.mbpo_training import MBPOTrainer
        except ImportError as error:
            raise InputError(
                "mbpo needs JAX, Equinox and Optax, which the extra learn installs: pip install 'centralpath[learn]'"
            ) from error
        return MBPOTrainer(self, experiment)
