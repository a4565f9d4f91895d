"""Model-based policy optimisation: a soft actor-critic trained on short rollouts of a learned model."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from dynamics.settings import setting
from ocp.errors import InputError
from ocp.learning.experiment import Experiment
from ocp.learning.protocol import Algorithm, Row, State, TrainedPolicy

if TYPE_CHECKING:
    from ocp.learning.mbpo_training import MBPOTrainer


@dataclass(frozen=True, kw_only=True)
class MBPO(Algorithm):
    """Model-based policy optimisation with a soft actor-critic.

    Algorithm 2 of Janner, Fu, Zhang and Levine, When to trust your model, 2019. Real steps are simulated under
    the exact law for any law of the experiment. Before iteration 0, ``random_steps`` steps are simulated under
    random policies. Each iteration

    - continues ``n_envs`` episodes for ``steps`` steps with noisy actions of the policy;
    - fits the ensemble to all real steps but a share ``held_out``, on which the ``elites`` best members are selected;
    - simulates ``branches`` rollouts of the model from real states, whose length grows from
      ``min_branch`` to ``max_branch`` steps over the first half of the iterations;
    - updates actor and critics ``updates`` times on batches with a share ``real_ratio`` of real
      steps; the other steps are from the branches of the last ``branch_iterations`` iterations.

    Rewards and ends of model steps are computed by the task's functions. Rewards for the critics are clipped to
    ``[-reward_clip, reward_clip]``, so that one extreme reward, for example just before a fall, does not dominate.
    Actions before tanh start with standard deviation ``sigma``. The temperature starts at ``alpha`` and is
    adapted so that the entropy per input is ``target_entropy``; a Gaussian well within the bounds, with
    standard deviation s in half ranges, has 1.42 + ln s.

    The policy has the experiment's tanh layers, on observations normalised by the steps of the random policies.
    The critics' discount is ``critic_discount`` times the experiment's discount. Default sizes suit two cores;
    Janner's are 4 x 200 units, batches of 256, 400 branches and 20 to 40 updates per step.
    """

    name: ClassVar[str] = "mbpo"
    summary: ClassVar[str] = "soft actor-critic on short branches of a network ensemble"
    contact: ClassVar[str] = "exact"

    n_envs: int = setting(16, "episodes continued under the exact law in each iteration", least=1)
    steps: int = setting(16, "steps of each continued episode", least=1)
    random_steps: int = setting(2048, "steps of random policies in iteration 0", least=1)
    capacity: int = setting(100_000, "steps that are stored", least=1, most=10_000_000)
    members: int = setting(7, "networks of the ensemble", least=1)
    elites: int = setting(5, "networks with the smallest errors, which predict the steps", least=1)
    model_units: int = setting(100, "units of a layer of the model", least=1)
    model_layers: int = setting(3, "layers of the model", least=1)
    model_rate: float = setting(1e-3, "learning rate of the model", above=0)
    model_steps: int = setting(200, "gradient steps of the model per iteration", least=1)
    model_batch: int = setting(128, "batch size of the model", least=1)
    held_out: float = setting(0.1, "share of the transitions that selects the elites", least=0.01, most=0.5)
    branches: int = setting(400, "model branches per iteration", least=1)
    min_branch: int = setting(1, "branch length in the first half of the iterations", least=1)
    max_branch: int = setting(5, "branch length in the second half", least=1, most=1000)
    branch_iterations: int = setting(10, "iterations whose branches are stored", least=1)
    critic_units: int = setting(128, "units of a layer of the critics", least=1)
    critic_layers: int = setting(2, "layers of the critics", least=1)
    rate: float = setting(3e-4, "learning rate of actor, critics and temperature", above=0)
    sigma: float = setting(0.3, "initial standard deviation of the actions before tanh", above=0)
    alpha: float = setting(0.1, "initial entropy temperature", above=0)
    target_entropy: float = setting(-1.0, "target entropy per input", least=-10, most=0.6)
    reward_clip: float = setting(math.inf, "largest absolute reward given to the critics", least=1e-9)
    critic_discount: float = setting(0.99, "factor on the experiment's discount for the critics", least=0, most=1)
    tau: float = setting(0.005, "step of the target critics toward the critics", least=0, most=1)
    updates: int = setting(1000, "updates of actor and critics per iteration", least=1)
    batch: int = setting(128, "batch size of an update", least=1)
    real_ratio: float = setting(0.05, "share of real transitions in a batch", least=0, most=1)

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, minimum in {"members": "elites", "max_branch": "min_branch", "capacity": "random_steps"}.items():
            if getattr(self, name) < getattr(self, minimum):
                raise InputError(
                    f"mbpo: {name} must be at least {minimum}, {getattr(self, minimum)}, got {getattr(self, name)}"
                )

    def begin(self, experiment: Experiment) -> State:
        """Return the initial state: networks initialised from the seed, and transitions of random policies.

        Raises :class:`~ocp.errors.InputError` if settings do not fit or the extra ``learn`` is not installed.
        """
        self.check(experiment)
        return self._trainer(experiment).initial_state()

    def iterate(self, experiment: Experiment, state: State, k: int) -> tuple[State, Row]:
        """Take steps under the exact law, fit the ensemble, and train actor and critics on its rollouts."""
        return self._trainer(experiment).iterate(state, k)

    def policy(self, experiment: Experiment, state: State) -> TrainedPolicy:
        """Return the policy that applies the actor's mean action."""
        return self._trainer(experiment).policy(state)

    def check(self, experiment: Experiment) -> None:
        """Raise :class:`~ocp.errors.InputError` for a policy without observations and for a policy to start from."""
        if experiment.hidden is None:
            raise InputError(
                f"mbpo learns a policy that observes, and {experiment.task.name} has one constant"
                " input here; give it hidden layers"
            )
        if experiment.start is not None:
            raise InputError("mbpo learns networks of its own and cannot start from a policy; leave start out")

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
