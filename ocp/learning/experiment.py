"""Experiments: a task, an algorithm, the contact law through which it learns, and a seed."""

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
    from ocp.learning.protocol import Algorithm, Trained

T = TypeVar("T")
"""Type of a cached object."""

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
"""Attributes that are recorded among the settings."""
EXACT = Exact()
"""Law under which every policy is evaluated."""


class Budget(NamedTuple):
    """Number of simulated ``steps`` to learn from, and of ``judgements`` at equal distances along them."""

    steps: int
    judgements: int

    def passed(self, spent: float) -> int:
        """Return the number of whole distances between judgements in ``spent`` steps."""
        return int(spent * self.judgements // self.steps)


@dataclass(frozen=True, eq=False, kw_only=True)
class Experiment(Configured):
    """Maximise ``E sum_t discount^t reward_t`` over the parameters of a policy.

    The policy is ``u = mid + half tanh(a)``, ``a = W_L tanh(... W_1 o + b_1 ...) + b_L + w``, with
    tanh layers of sizes ``hidden`` on normalised observations; ``()`` is the affine policy and None
    one input for all steps, without observations. Weights start normal with standard deviation
    1 / sqrt(fan in), those of the last layer ``initial`` times that, offsets at 0; with a state
    ``rest`` (nx,) they are those of linear feedback that keeps the system there; with a policy
    ``start`` its own, with what it has seen.

    The algorithm learns through ``law``, at the task's parameters ``model_params`` (all, in the
    order of the task's table; by default its own); evaluations are under the exact law, of
    ``episodes`` episodes before every ``evaluate_every``-th iteration and at the end. With a
    ``budget`` learning ends with the iteration that has spent its steps, however many iterations
    that takes, and is judged at its distances. ``params`` is what the task was built of, for the
    record. Results do not depend on ``threads``.

    Raises :class:`~ocp.errors.InputError` for sizes below 1, a discount outside (0, 1] and
    the like.
    """

    task: Task
    algorithm: Algorithm
    law: ContactLaw = field(default_factory=lambda: Adaptive("quartic"))
    hidden: tuple[int, ...] | None = setting(
        (),
        "units of each tanh layer, as 64,64; affine, or open-loop",
        hint="with commas, such as 64,64, affine or open-loop",
        least=1,
        most=100_000,
    )
    initial: float = setting(0.1, "size of the last layer's first weights", least=0)
    rest: tuple[float, ...] | None = None
    normalise: bool = setting(True, "observations by their running mean and scale")
    discount: float = setting(1.0, "discount of later rewards", hint="1 counts all rewards alike", above=0, most=1)
    seed: int = setting(0, least=0)
    iterations: int = setting(100, least=1)
    evaluate_every: int = setting(10, "iterations between judgements under the exact law", least=1)
    episodes: int = setting(16, "episodes of each judgement", least=1)
    budget: Budget | None = None
    model_params: np.ndarray | None = None
    start: Trained | None = None
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

    def _check_start(self, start: Trained) -> None:
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
        """The policy in the form of the batch engine."""
        task = self.task
        if self.hidden is None:
            return constant_policy(task.system.nx, task.lower, task.upper)
        return dense_policy(task.observe, self.hidden, task.lower, task.upper)

    def rollouts(self, horizon: int, law: ContactLaw | None = None) -> TaskRollouts:
        """Return unrolls of ``horizon`` steps under ``law`` (default: the model's), compiled once."""
        contact_law = self.law if law is None else law
        compiled = [rollouts for rollouts in self._compiled if rollouts.law is contact_law]
        for rollouts in compiled:
            if rollouts.horizon == horizon:
                return rollouts
        extended = (rollouts.over(horizon) for rollouts in compiled)
        task_rollouts = next((rollouts for rollouts in extended if rollouts is not None), None)
        if task_rollouts is None:
            task_rollouts = TaskRollouts(self.task, contact_law, self.policy, horizon, threads=self.threads)
        self._compiled.append(task_rollouts)
        return task_rollouts

    def cached(self, make: Callable[[Experiment], T]) -> T:
        """Return ``make(experiment)``, computed at the first call only."""
        if make not in self._cache:
            self._cache[make] = make(self)
        return self._cache[make]

    def count_steps(self, steps: float) -> None:
        """Count ``steps`` of any contact law that were simulated to learn from.

        Whatever simulates for an algorithm calls it; judgements do not count.
        """
        self._step_counts.append(float(steps))

    def take_step_count(self) -> float:
        """Return the steps counted by :meth:`count_steps` since the last call."""
        total = sum(self._step_counts)
        self._step_counts.clear()
        return total

    @property
    def physics(self) -> np.ndarray:
        """Parameters of the model: ``model_params``, or the task's own."""
        model_params = self.model_params
        return self.task.parameters.values if model_params is None else np.asarray(model_params, float)

    def rng(self, k: int, purpose: str) -> np.random.Generator:
        """Return the random generator of iteration ``k`` for one purpose, the same at every call."""
        return np.random.default_rng(self._sequence(k, purpose))

    def noise(self, sigma: float, k: int, purpose: str) -> Gaussian:
        """Return the noise of iteration ``k`` on the inputs for one purpose."""
        return Gaussian(sigma, self._sequence(k, purpose))

    def _sequence(self, k: int, purpose: str) -> np.random.SeedSequence:
        return np.random.SeedSequence([self.seed, k, zlib.crc32(purpose.encode())])

    def first_theta(self) -> np.ndarray:
        """Return the initial parameters (n_theta,): those of ``start``, balancing ``rest``, or random."""
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
        """Return initial states (n, nx) of episodes, at the model's parameters."""
        return self.task.reset(n, rng, self.physics)

    def observations(self, states: np.ndarray) -> np.ndarray:
        """Return the policy's observations (n, n_o), not normalised, in states (n, nx)."""
        return self._observe(states, self.physics)

    def inputs(self, trained: Trained, states: np.ndarray, noise: np.ndarray | float = 0.0) -> np.ndarray:
        """Return inputs (n, nu) of a policy in states (n, nx), with ``noise`` (n, nu) on its actions."""
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
        """Return the settings that decide the result by name; ``iterations`` is left out, since it may grow."""
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
