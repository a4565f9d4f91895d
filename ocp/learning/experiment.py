"""Learning experiments: a task, an algorithm, the contact law of its model, and a seed."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np

from dynamics.batch import BatchFunction, DensePolicy, Gaussian, RolloutPolicy, constant_policy, dense_policy
from dynamics.contact import Adaptive, ContactLaw, Exact
from dynamics.settings import Configured, read_count, setting
from ocp.errors import InputError
from ocp.learning.explorer import squash
from ocp.learning.protocol import balancing_feedback, embed_affine, first_weights
from ocp.learning.rollouts import TaskRollouts
from ocp.problem.task import Task

if TYPE_CHECKING:
    from ocp.learning.protocol import Algorithm, TrainedPolicy

T = TypeVar("T")
"""Type variable of a cached object."""

RECORDED_SETTINGS = (
    "hidden",
    "initial",
    "rest",
    "normalise",
    "discount",
    "seed",
    "evaluate_every",
    "episodes",
    "budget",
)
"""Names of an experiment's attributes that are recorded as settings."""
EXACT = Exact()
"""Exact contact law, under which all policies are evaluated."""


class Budget(NamedTuple):
    """Number of simulated ``steps`` after which learning ends, and number of equally spaced evaluations."""

    steps: int
    n_evaluations: int

    def intervals_in(self, steps: float) -> int:
        """Return the number of whole intervals between evaluations in a number of simulated ``steps``."""
        return int(steps * self.n_evaluations // self.steps)


@dataclass(frozen=True, eq=False, kw_only=True)
class Experiment(Configured):
    """Learning experiment that maximises ``E sum_t discount^t reward_t`` over the parameters of a policy.

    The policy is ``u = mid + half tanh(a)``, ``a = W_L tanh(... W_1 o + b_1 ...) + b_L + w``, with tanh layers
    of sizes ``hidden`` on normalised observations and noise w; ``hidden = ()`` is the affine policy, and None a
    constant input without observations. Initial weights are normal with standard deviation 1 / sqrt(fan in),
    multiplied by ``initial`` in the last layer; offsets are 0. If a state ``rest`` (nx,) is given, the initial
    policy is instead linear feedback that stabilises the system at that state. If a policy ``start`` is given,
    learning starts from the weights and the normaliser of that policy.

    The algorithm learns under the contact law ``law``, on a model with the parameters ``model_params``, all of
    them in the order of the task's table (default: the task's own values). The policy is evaluated in
    ``episodes`` episodes under the exact law, before every ``evaluate_every``-th iteration and at the end. With
    a ``budget``, learning ends with the iteration that exceeds the budget's number of steps, whatever
    ``iterations`` is, and evaluations are equally spaced in simulated steps. ``params`` are the arguments from
    which the task was built, for the record. Results do not depend on ``threads``.

    Raises :class:`~ocp.errors.InputError` for invalid settings, such as a discount outside (0, 1].
    """

    task: Task
    algorithm: Algorithm
    law: ContactLaw = field(default_factory=lambda: Adaptive("quartic"))
    hidden: tuple[int, ...] | None = setting(
        (),
        "units of each tanh layer, such as 64,64; or affine, or open-loop",
        hint="with commas, such as 64,64, affine or open-loop",
        least=1,
        most=100_000,
    )
    initial: float = setting(0.1, "factor on the initial weights of the last layer", least=0)
    rest: tuple[float, ...] | None = None
    normalise: bool = setting(True, "normalise observations by their running mean and scale")
    discount: float = setting(1.0, "discount of later rewards", hint="1 counts all rewards alike", above=0, most=1)
    seed: int = setting(0, least=0)
    iterations: int = setting(100, least=1)
    evaluate_every: int = setting(10, "iterations between evaluations under the exact law", least=1)
    episodes: int = setting(16, "episodes of each evaluation", least=1)
    budget: Budget | None = None
    model_params: np.ndarray | None = None
    start: TrainedPolicy | None = None
    params: Mapping[str, Any] = field(default_factory=dict)
    threads: int | None = None
    _compiled: list[TaskRollouts] = field(default_factory=list, init=False)
    _cache: dict[Any, Any] = field(default_factory=dict, init=False)
    _step_counts: list[float] = field(default_factory=list, init=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, value in self.budget._asdict().items() if self.budget else ():
            read_count(f"the budget's {name}", value)
        size = len(self.task.parameters)
        if self.model_params is not None and np.shape(self.model_params) != (size,):
            raise InputError(
                f"model_params has shape {np.shape(self.model_params)}, expected ({size},), the"
                f" parameters of {self.task.name}"
            )
        if self.start is not None:
            self._check_start(self.start)

    def _check_start(self, start: TrainedPolicy) -> None:
        sizes = np.shape(start.theta), np.shape(start.normaliser.mean)
        expected = (self.policy.n_theta,), (len(self.task.observations),)
        if sizes != expected:
            raise InputError(
                f"the policy to start from has parameters {sizes[0]} and sees observations"
                f" {sizes[1]}, but {self.task.name} with hidden layers {self.hidden} takes"
                f" {expected[0]} and {expected[1]}; start from a policy of the same task and layers"
            )

    @cached_property
    def policy(self) -> RolloutPolicy:
        """Policy as a function that the batch engine compiles into rollouts."""
        task = self.task
        if self.hidden is None:
            return constant_policy(task.system.nx, task.lower, task.upper)
        return dense_policy(task.observe, self.hidden, task.lower, task.upper)

    def rollouts(self, horizon: int, law: ContactLaw | None = None) -> TaskRollouts:
        """Return compiled rollouts of ``horizon`` steps under ``law`` (default: the experiment's law), from a cache."""
        contact_law = self.law if law is None else law
        compiled = [rollouts for rollouts in self._compiled if rollouts.law is contact_law]
        for rollouts in compiled:
            if rollouts.horizon == horizon:
                return rollouts
        extended = (rollouts.with_horizon(horizon) for rollouts in compiled)
        task_rollouts = next((rollouts for rollouts in extended if rollouts is not None), None)
        if task_rollouts is None:
            task_rollouts = TaskRollouts(self.task, contact_law, self.policy, horizon, threads=self.threads)
        self._compiled.append(task_rollouts)
        return task_rollouts

    def cached(self, make: Callable[[Experiment], T]) -> T:
        """Return ``make(experiment)``, which is computed only at the first call."""
        if make not in self._cache:
            self._cache[make] = make(self)
        return self._cache[make]

    def count_steps(self, steps: float) -> None:
        """Add ``steps`` to the number of steps simulated for learning, under any contact law.

        Every simulation for an algorithm calls this; evaluations are not counted.
        """
        self._step_counts.append(float(steps))

    def take_step_count(self) -> float:
        """Return the number of steps counted by :meth:`count_steps` since the last call, and reset it."""
        total = sum(self._step_counts)
        self._step_counts.clear()
        return total

    @property
    def physics(self) -> np.ndarray:
        """Physical parameters (np,) of the model: ``model_params``, or the task's values."""
        model_params = self.model_params
        return self.task.parameters.values if model_params is None else np.asarray(model_params, float)

    def rng(self, k: int, purpose: str) -> np.random.Generator:
        """Return a random generator seeded by iteration ``k`` and a purpose, always in its initial state."""
        return np.random.default_rng(self._sequence(k, purpose))

    def noise(self, sigma: float, k: int, purpose: str) -> Gaussian:
        """Return Gaussian noise on actions with standard deviation ``sigma``, seeded by iteration and purpose."""
        return Gaussian(sigma, self._sequence(k, purpose))

    def _sequence(self, k: int, purpose: str) -> np.random.SeedSequence:
        return np.random.SeedSequence([self.seed, k, zlib.crc32(purpose.encode())])

    def first_theta(self) -> np.ndarray:
        """Return the initial parameters (n_theta,): from the policy ``start``, from feedback to ``rest``, or random."""
        if self.start is not None:
            return np.array(self.start.theta, dtype=float)
        rng = self.rng(0, "theta")
        if not isinstance(self.policy, DensePolicy):
            return self.initial * rng.standard_normal(self.policy.n_theta)
        theta = first_weights(self.policy.sizes, self.initial, rng)
        if self.rest is not None:
            embed_affine(*balancing_feedback(self.task, np.array(self.rest)), self.policy.layers(theta))
        return theta

    def first_states(self, n: int, rng: np.random.Generator) -> np.ndarray:
        """Return random initial states (n, nx) of episodes of the model with its parameters."""
        return self.task.reset(n, rng, self.physics)

    def observations(self, states: np.ndarray) -> np.ndarray:
        """Return the observations (n, n_o), not normalised, in states (n, nx)."""
        return self._observe(states, self.physics)

    def inputs(self, trained: TrainedPolicy, states: np.ndarray, noise: np.ndarray | float = 0.0) -> np.ndarray:
        """Return the inputs (n, nu) of a policy in states (n, nx), with ``noise`` (n, nu) on its actions."""
        if isinstance(self.policy, DensePolicy):
            normaliser = trained.normaliser
            observations = (self.observations(states) - normaliser.mean) / normaliser.scale
            action = self.policy.mean_actions(trained.theta, observations)
        else:
            action = np.broadcast_to(trained.theta, (len(states), self.task.system.nu))
        return squash(self.task, action + noise)

    @cached_property
    def _observe(self) -> BatchFunction:
        return BatchFunction(self.task.observe, "numpy", 1)

    def settings(self) -> dict[str, Any]:
        """Return a mapping from names to settings, without ``iterations``, which may change when training continues."""
        law = {"law": self.law.name, **self.law.settings()}
        return {
            "task": self.task.name,
            "params": dict(self.params),
            "algorithm": self.algorithm.name,
            **{f"algorithm.{key}": value for key, value in self.algorithm.settings().items()},
            **{f"contact.{key}": value for key, value in law.items()},
            **{name: getattr(self, name) for name in RECORDED_SETTINGS},
            "psi": self.physics,
            "start": None if self.start is None else self.start.digest,
        }
