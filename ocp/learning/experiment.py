"""A policy to be learned: the task, the algorithm, the contact law it learns through, the seed."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, TypeVar

import numpy as np

from dynamics.batch import BatchFunction, DensePolicy, Gaussian, RolloutPolicy, constant, dense
from dynamics.contact import Adaptive, ContactLaw, Exact
from ocp.errors import InputError
from ocp.learning.explorer import squash
from ocp.learning.protocol import balancing_feedback, embed_affine, first_weights
from ocp.learning.rollouts import TaskRollouts
from ocp.problem.task import Task

if TYPE_CHECKING:
    from ocp.learning.protocol import Algorithm, Trained

T = TypeVar("T")

_RECORDED = ("hidden", "initial", "rest", "normalise", "discount", "seed", "evaluate_every", "episodes", "budget")
EXACT = Exact()
"""The law that every policy is judged under."""


class Budget(NamedTuple):
    """Simulated ``steps`` to learn from, and ``judgements`` at even distances along them."""

    steps: int
    judgements: int

    def passed(self, spent: float) -> int:
        """How many of the distances between judgements ``spent`` steps have covered."""
        return int(spent * self.judgements // self.steps)


@dataclass(frozen=True, eq=False, kw_only=True)
class Experiment:
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
    hidden: Annotated[tuple[int, ...] | None, "units of each tanh layer, as 64,64; affine, or open-loop"] = ()
    initial: Annotated[float, "size of the last layer's first weights"] = 0.1
    rest: tuple[float, ...] | None = None
    normalise: Annotated[bool, "observations by their running mean and scale"] = True
    discount: Annotated[float, "of later rewards, above 0 and at most 1"] = 1.0
    seed: int = 0
    iterations: int = 100
    evaluate_every: Annotated[int, "iterations between judgements under the exact law"] = 10
    episodes: Annotated[int, "of each judgement"] = 16
    budget: Budget | None = None
    model_params: np.ndarray | None = None
    start: Trained | None = None
    params: Mapping[str, Any] = field(default_factory=dict)
    threads: int | None = None
    _compiled: list[TaskRollouts] = field(default_factory=list, init=False)
    _made: dict[Any, Any] = field(default_factory=dict, init=False)
    _counted: list[float] = field(default_factory=list, init=False)

    def __post_init__(self) -> None:
        for name in ("iterations", "evaluate_every", "episodes"):
            at_least(1, name, getattr(self, name))
        for width in self.hidden or ():
            at_least(1, "a hidden layer", width)
        for name, value in self.budget._asdict().items() if self.budget else ():
            at_least(1, f"the budget's {name}", value)
        at_least(0, "seed", self.seed)
        if not 0 < self.discount <= 1:
            raise InputError(
                f"discount must be above 0 and at most 1, got {self.discount:g}; 1 counts all rewards alike"
            )
        not_below(0, "initial", self.initial)
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
        """The policy as the engine takes it."""
        task = self.task
        if self.hidden is None:
            return constant(task.system.nx, task.lower, task.upper)
        return dense(task.observe, self.hidden, task.lower, task.upper)

    def rollouts(self, horizon: int, law: ContactLaw | None = None) -> TaskRollouts:
        """Unrolls of ``horizon`` steps, compiled once; through ``law``, by default the model's."""
        chosen = self.law if law is None else law
        known = [each for each in self._compiled if each.law is chosen]
        for each in known:
            if each.horizon == horizon:
                return each
        others = (each.over(horizon) for each in known)
        found = next((each for each in others if each is not None), None)
        if found is None:
            found = TaskRollouts(self.task, chosen, self.policy, horizon, threads=self.threads)
        self._compiled.append(found)
        return found

    def cached(self, make: Callable[[Experiment], T]) -> T:
        """What ``make`` makes of the experiment, made at the first asking only."""
        if make not in self._made:
            self._made[make] = make(self)
        return self._made[make]

    def count_steps(self, steps: float) -> None:
        """Count ``steps`` of any contact law that were simulated to learn from.

        Whatever simulates for an algorithm calls it; judgements do not count.
        """
        self._counted.append(float(steps))

    def take_step_count(self) -> float:
        """Steps that :meth:`count_steps` has counted since the last call."""
        total = sum(self._counted)
        self._counted.clear()
        return total

    @property
    def physics(self) -> np.ndarray:
        """``model_params``, or the task's own parameters."""
        given = self.model_params
        return self.task.parameters.values if given is None else np.asarray(given, float)

    def rng(self, k: int, purpose: str) -> np.random.Generator:
        """Numbers of iteration ``k`` for one purpose, the same however often they are asked."""
        return np.random.default_rng(self._sequence(k, purpose))

    def noise(self, sigma: float, k: int, purpose: str) -> Gaussian:
        """Noise of iteration ``k`` on the inputs for one purpose."""
        return Gaussian(sigma, self._sequence(k, purpose))

    def _sequence(self, k: int, purpose: str) -> np.random.SeedSequence:
        return np.random.SeedSequence([self.seed, k, zlib.crc32(purpose.encode())])

    def first_theta(self) -> np.ndarray:
        """Parameters (n_theta,) to start from: of ``start``, balancing ``rest``, or by chance."""
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
        """First states (n, nx) of episodes, at the model's parameters."""
        return self.task.reset(n, rng, self.physics)

    def observations(self, states: np.ndarray) -> np.ndarray:
        """What a policy sees, before it is normalised, (n, n_o), in states (n, nx)."""
        return self._observe(states, self.physics)

    def inputs(self, trained: Trained, states: np.ndarray, noise: np.ndarray | float = 0.0) -> np.ndarray:
        """Inputs (n, nu) of a policy in states (n, nx), with ``noise`` (n, nu) on its actions."""
        if isinstance(self.policy, DensePolicy):
            normaliser = trained.normaliser
            seen = (self.observations(states) - normaliser.mean) / normaliser.scale
            action = self.policy.means(trained.theta, seen)
        else:
            action = np.broadcast_to(trained.theta, (len(states), self.task.system.nu))
        return squash(self.task, action + noise)

    @cached_property
    def _observe(self) -> BatchFunction:
        return BatchFunction(self.task.observe, "numpy", 1)

    def settings(self) -> dict[str, Any]:
        """What decides the result, by name, but for ``iterations``: more of them go on."""
        law = {"law": self.law.name, **self.law.settings()}
        return {
            "task": self.task.name,
            "params": dict(self.params),
            "algorithm": self.algorithm.name,
            **{f"algorithm.{key}": value for key, value in self.algorithm.settings().items()},
            **{f"contact.{key}": value for key, value in law.items()},
            **{name: getattr(self, name) for name in _RECORDED},
            "psi": self.physics,
            "start": None if self.start is None else self.start.digest,
        }


def at_least(least: int, name: str, value: int) -> None:
    """Raise :class:`~ocp.errors.InputError` unless ``value`` is a whole number from ``least``."""
    whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not whole or value < least:
        raise InputError(f"{name} must be a whole number of at least {least}, got {value!r}")


def not_below(low: float, name: str, value: float) -> None:
    """Raise :class:`~ocp.errors.InputError` unless ``value`` is finite and at least ``low``."""
    if not (np.isfinite(value) and value >= low):
        raise InputError(f"{name} must be a finite number of at least {low:g}, got {value!r}")


def positive(name: str, value: float) -> None:
    """Raise :class:`~ocp.errors.InputError` unless ``value`` is positive and finite."""
    if not (np.isfinite(value) and value > 0):
        raise InputError(f"{name} must be positive and finite, got {value!r}")
