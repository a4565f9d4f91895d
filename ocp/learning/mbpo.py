"""Model-based policy optimisation: a soft actor-critic on a model's short branches."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, ClassVar

from ocp.errors import InputError
from ocp.learning.experiment import Experiment, check_at_least, check_positive
from ocp.learning.protocol import Algorithm, Row, State, Trained

if TYPE_CHECKING:
    from ocp.learning.mbpo_training import MBPOTrainer


@dataclass(frozen=True, kw_only=True)
class MBPO(Algorithm):
    """Model-based policy optimisation with a soft actor-critic.

    Janner, Fu, Zhang and Levine, When to trust your model, 2019, algorithm 2. In every iteration
    ``n_envs`` episodes go on for ``steps`` steps under the exact law, whatever the experiment's law,
    with noisy actions of the policy (in iteration 0 of random policies, ``explored`` steps); the
    ensemble is fitted to all real steps, of which a share ``held_out`` selects its ``elites``; its
    ``branches`` start at real states, first ``min_branch`` steps long, later ``max_branch`` (from
    half of the iterations on); and the actor-critic is updated ``updates`` times
    on batches with a share ``real_ratio`` of real steps, the rest of the last ``kept`` iterations'
    branches. Reward and end of a step of the model are the task's, but the critics see rewards
    clipped to ``reward_clip`` in size, so that they do not learn from one good step before a fall.
    Actions before tanh start with deviation ``sigma``, the temperature with ``alpha``, which keeps
    the entropy at ``target_entropy`` per input: for a Gaussian well within the bounds, of deviation
    s in half ranges, 1.42 + ln s.

    The policy is the experiment's: tanh layers on observations, normalised once by the explored
    steps. The critics' discount is ``critic_discount`` times the experiment's. Sizes are for two
    cores; Janner's are 4 x 200 units, 256 in a batch, 400 branches and 20 to 40 updates a step.
    """

    name: ClassVar[str] = "mbpo"
    summary: ClassVar[str] = "soft actor-critic on short branches of a network ensemble"
    contact: ClassVar[str] = "exact"

    n_envs: Annotated[int, "episodes continued under the exact law in each iteration"] = 16
    steps: Annotated[int, "steps of each continued episode"] = 16
    explored: Annotated[int, "steps of random policies in iteration 0"] = 2048
    capacity: Annotated[int, "steps that are kept"] = 100_000
    members: Annotated[int, "networks of the ensemble"] = 7
    elites: Annotated[int, "networks used: the elites"] = 5
    model_units: Annotated[int, "units of a layer of the model"] = 100
    model_layers: Annotated[int, "layers of the model"] = 3
    model_rate: Annotated[float, "learning rate of the model"] = 1e-3
    model_steps: Annotated[int, "gradient steps of the model per iteration"] = 200
    model_batch: Annotated[int, "batch size of the model"] = 128
    held_out: Annotated[float, "share of the transitions that selects the elites"] = 0.1
    branches: Annotated[int, "model branches per iteration"] = 400
    min_branch: Annotated[int, "branch length in the first half of the iterations"] = 1
    max_branch: Annotated[int, "branch length in the second half"] = 5
    kept: Annotated[int, "iterations whose branches are kept for learning"] = 10
    critic_units: Annotated[int, "units of a layer of the critics"] = 128
    critic_layers: Annotated[int, "layers of the critics"] = 2
    rate: Annotated[float, "learning rate of actor, critics and temperature"] = 3e-4
    sigma: Annotated[float, "initial standard deviation of the actions before tanh"] = 0.3
    alpha: Annotated[float, "initial entropy temperature"] = 0.1
    target_entropy: Annotated[float, "target entropy per input"] = -1.0
    reward_clip: Annotated[float, "largest absolute reward given to the critics"] = math.inf
    critic_discount: Annotated[float, "factor on the experiment's discount for the critics"] = 0.99
    tau: Annotated[float, "step of the target critics toward the critics"] = 0.005
    updates: Annotated[int, "updates of actor and critics per iteration"] = 1000
    batch: Annotated[int, "batch size of an update"] = 128
    real_ratio: Annotated[float, "share of real transitions in a batch"] = 0.05

    def begin(self, experiment: Experiment) -> State:
        """Return networks initialised from the seed, and the explored steps.

        Raises :class:`~ocp.errors.InputError` where settings do not fit, and where the extra
        ``learn`` is not installed.
        """
        self.check(experiment)
        return self._trainer(experiment).initial_state()

    def iterate(self, experiment: Experiment, state: State, k: int) -> tuple[State, Row]:
        """Take steps under the exact law, then train the ensemble, its branches' actor and critics."""
        return self._trainer(experiment).iterate(state, k)

    def policy(self, experiment: Experiment, state: State) -> Trained:
        """Return the policy of the mean action."""
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
        integer_settings = "n_envs steps explored members elites model_units model_layers model_steps"
        integer_settings += " model_batch branches min_branch kept critic_units critic_layers updates batch"
        for name in integer_settings.split():
            check_at_least(1, name, getattr(self, name))
        for name in ("model_rate", "rate", "alpha", "sigma"):
            check_positive(name, getattr(self, name))
        for name, (lower, upper) in {
            "elites": (1, self.members),
            "max_branch": (self.min_branch, 1000),
            "target_entropy": (-10.0, 0.6),
            "held_out": (0.01, 0.5),
            "reward_clip": (1e-9, math.inf),
            "real_ratio": (0, 1),
            "critic_discount": (0, 1),
            "tau": (0, 1),
            "capacity": (self.explored, 10_000_000),
        }.items():
            value = getattr(self, name)
            if not lower <= value <= upper:
                raise InputError(f"{name} must be between {lower:g} and {upper:g}, got {value!r}")

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
