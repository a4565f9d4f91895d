"""Unrolls of the policy that is learned, and steps uphill along their gradients."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Any, ClassVar

import numpy as np

from dynamics.batch import Episodes
from dynamics.contact import ContactLaw
from ocp.errors import InputError, NotConverged, choose
from ocp.learning.experiment import Experiment, at_least, positive
from ocp.learning.protocol import Algorithm, Normaliser, Row, State, Trained, renormalised

Slope = Callable[[np.ndarray], tuple[float, np.ndarray]]
"""Maps parameters to a cost and its gradient, which may be a sample of it."""

DECAY = (0.9, 0.999)


def adam_step(
    gradient: np.ndarray, m: np.ndarray, v: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Step ``count`` = 1, 2, ... at rate 1, and the next m and v (Kingma and Ba, algorithm 1).

    ``m <- b1 m + (1 - b1) g``, ``v <- b2 v + (1 - b2) g²`` and the step
    ``m/(1 - b1^t) / (sqrt(v/(1 - b2^t)) + 1e-8)``, b1, b2 = 0.9, 0.999.
    """
    m = DECAY[0] * m + (1 - DECAY[0]) * gradient
    v = DECAY[1] * v + (1 - DECAY[1]) * gradient**2
    first, second = m / (1 - DECAY[0] ** count), v / (1 - DECAY[1] ** count)
    return first / (np.sqrt(second) + 1e-8), m, v


def adam(slope: Slope, theta: np.ndarray, rate: float) -> Iterator[tuple[np.ndarray, float]]:
    """Give theta and its cost, before each step down by ``rate``, for ever.

    Raises ``ValueError`` where a gradient is not finite.
    """
    theta = np.array(theta, dtype=float)
    m, v = np.zeros_like(theta), np.zeros_like(theta)
    count = 0
    while True:
        cost, gradient = slope(theta)
        yield theta.copy(), cost
        if not np.isfinite(gradient).all():
            raise ValueError(f"adam: the gradient of step {count} is not finite; lower the rate")
        count += 1
        step, m, v = adam_step(gradient, m, v, count)
        theta -= rate * step


LIMIT = 1e3
"""Largest entry of a gradient that normalised ascent follows."""

Rule = Callable[[State, np.ndarray, float], State]
"""Maps (state, gradient, rate) to the entries of the state that change, ``theta`` among them."""


def ascend(rule: str, state: State, gradient: np.ndarray, rate: float) -> State:
    """State after a step from its ``theta`` along ``gradient``, both (n_theta,).

    ``adam`` is Kingma and Ba's; ``normalised`` is ``theta + rate g / |g|_inf``, and stays where
    |g|_inf is 1000 or more (Dojo's augmented gradient search); ``plain`` is ``theta + rate g``, of
    abs, eq. 4.3. Raises :class:`~ocp.errors.InputError` for another ``rule``.
    """
    return {**state, **choose("optimiser", rule, RULES)(state, gradient, rate)}


def _adam(state: State, gradient: np.ndarray, rate: float) -> State:
    zero = np.zeros_like(gradient)
    m, v, count = state.get("adam.m", zero), state.get("adam.v", zero), state.get("adam.count", 0)
    step, m, v = adam_step(gradient, m, v, int(count) + 1)
    return {
        "theta": state["theta"] + rate * step,
        "adam.m": m,
        "adam.v": v,
        "adam.count": np.array(int(count) + 1),
    }


def _normalised(state: State, gradient: np.ndarray, rate: float) -> State:
    size = np.abs(gradient).max(initial=0.0)
    step = gradient / size if 0 < size < LIMIT else 0.0 * gradient
    return {"theta": state["theta"] + rate * step}


def _plain(state: State, gradient: np.ndarray, rate: float) -> State:
    return {"theta": state["theta"] + rate * gradient}


RULES: dict[str, Rule] = {"adam": _adam, "normalised": _normalised, "plain": _plain}


@dataclass(frozen=True)
class Starts:
    """The buffer: states ``x`` (n, nx), and how many steps of its episode each has behind it.

    Every unroll carries its episode on from where the one before left it; an episode that has
    ended or is as long as the task's starts again. Unrolls as long as episodes start new ones.
    """

    x: np.ndarray
    age: np.ndarray

    @classmethod
    def first(cls, experiment: Experiment, n: int, unroll: int) -> Starts:
        """First states, counted as of all ages so that episodes do not end at once."""
        rng, horizon = experiment.rng(0, "starts"), experiment.task.horizon
        return cls(experiment.first_states(n, rng), unroll * rng.integers(-(-horizon // unroll), size=n))

    def after(self, experiment: Experiment, states: np.ndarray, lived: np.ndarray, k: int) -> Starts:
        """Carried on by unrolls through ``states`` (n, H+1, nx) of which ``lived`` (n,) counted."""
        n, unroll = len(states), states.shape[1] - 1
        x, age = states[np.arange(n), lived], self.age + lived
        again = (lived < unroll) | (age >= experiment.task.horizon) | ~np.isfinite(x).all(axis=1)
        fresh = experiment.first_states(n, experiment.rng(k, "starts again"))
        return Starts(np.where(again[:, None], fresh, x), np.where(again, 0, age))

    def arrays(self) -> dict[str, np.ndarray]:
        """As a checkpoint holds it."""
        return {"starts.x": self.x, "starts.age": self.age}

    @classmethod
    def of(cls, state: dict[str, np.ndarray]) -> Starts:
        """Out of a state that holds :meth:`arrays`."""
        return cls(state["starts.x"], state["starts.age"])


def roll(
    experiment: Experiment,
    state: State,
    x0: np.ndarray,
    horizon: int,
    *,
    theta: np.ndarray | None = None,
    law: ContactLaw | None = None,
    **asked: Any,
) -> Episodes:
    """Unrolls of ``horizon`` steps from ``x0`` (n, nx) under the policy of ``state``.

    ``theta`` (n, n_theta) are other parameters for each sample, ``law`` another contact law than
    the model's; physical parameters are the state's ``psi`` where it has any; states are kept.
    ``asked`` (noise, gradient, score, along, pull) as :class:`~dynamics.batch.EpisodeFunction`.
    Samples that are not finite, where a contact found no solution or a motion overflowed, are left
    to :func:`finite_samples`.
    """
    found = experiment.rollouts(horizon, law)(
        x0,
        state["theta"] if theta is None else theta,
        Normaliser.of(state),
        discount=experiment.discount,
        model_params=state.get("psi", experiment.physics),
        n_samples=len(x0),
        states=True,
        **asked,
    )
    experiment.count_steps(found.lived.sum())
    return found


def finite_samples(experiment: Experiment, state: State, episodes: Episodes, k: int) -> np.ndarray:
    """Which samples (n,) count.

    Raises :class:`~ocp.errors.InputError` that names step and sample where states are finite and a
    reward is not, and :class:`~ocp.errors.NotConverged` where no sample is left.
    """
    good = np.isfinite(episodes.value)
    for part in (episodes.gradient, episodes.score):
        if part is not None:
            good &= np.isfinite(part).all(axis=1)
    for sample in np.flatnonzero(~np.isfinite(episodes.value)):
        if np.isfinite(episodes.states[sample]).all():
            step = _step_without_reward(experiment, Trained.of(state), episodes.states[sample])
            where = f"sample {sample} in iteration {k}"
            raise InputError(non_finite_reward(experiment, step, where))
    if not good.any():
        raise NotConverged(
            f"{experiment.task.name}: no sample of iteration {k} stayed finite; lower the learning"
            " rate, the noise or the unroll length"
        )
    return good


def _step_without_reward(experiment: Experiment, policy: Trained, states: np.ndarray) -> int:
    """First step without a finite reward under the inputs without noise; else the last state's."""
    task, inputs = experiment.task, experiment.inputs(policy, states[:-1])
    for t, (x, after) in enumerate(pairwise(states)):
        if not np.isfinite(float(task.rewards(x, inputs[t], after, experiment.physics))):
            return t
    return len(states) - 1


def non_finite_reward(experiment: Experiment, step: int, where: str) -> str:
    """That a reward is not a number, and where."""
    return (
        f"{experiment.task.name}: the reward of step {step} of {where} is NaN or infinite at"
        " finite states; correct the reward or end the episode earlier"
    )


def normalised_state(experiment: Experiment, state: State, episodes: Episodes, good: np.ndarray) -> State:
    """The state with what was seen in its normaliser, and the policy as it was."""
    steps = np.arange(episodes.states.shape[1] - 1)
    alive = good[:, None] & (steps < episodes.lived[:, None])
    seen = experiment.observations(episodes.states[:, :-1][alive])
    return with_observations(experiment, state, seen[np.isfinite(seen).all(axis=1)])


def with_observations(experiment: Experiment, state: State, seen: np.ndarray) -> State:
    """The state with observations (n, n_o) in its normaliser, and the policy as it was."""
    if not experiment.normalise:
        return state
    before = Normaliser.of(state)
    after = before.after(seen)
    theta = renormalised(experiment.policy, state["theta"], before, after)
    return {**state, **after.arrays(), "theta": theta}


def sample_row(episodes: Episodes, good: np.ndarray) -> Row:
    """What every algorithm tells of its samples."""
    return {
        "return_mean": float(episodes.value[good].mean()),
        "nonfinite": float((~good).sum()),
    }


@dataclass(frozen=True, kw_only=True)
class Unrolled(Algorithm):
    """Settings of an algorithm that unrolls a policy and steps along a gradient.

    ``samples`` unrolls of ``unroll`` steps, at most an episode's, from a buffer of states, with
    Gaussian noise of standard deviation ``sigma`` on the actions before tanh; steps of ``rate``
    by ``optimiser``, one of :func:`~ocp.learning.unrolling.ascend`'s.
    """

    samples: Annotated[int, "unrolls an iteration"] = 64
    unroll: Annotated[int, "steps of an unroll, at most an episode's"] = 32
    sigma: Annotated[float, "standard deviation of the noise on the actions before tanh"] = 0.1
    rate: Annotated[float, "learning rate"] = 0.01
    optimiser: Annotated[str, f"rule of a step: {', '.join(RULES)}"] = "adam"

    least: ClassVar[int] = 1
    """Samples that the estimate needs."""

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
        state = super().begin(experiment)
        starts = Starts.first(experiment, self.starts(), self.steps(experiment))
        return {**state, **starts.arrays()}

    def climb(self, state: State, gradient: np.ndarray) -> State:
        """The state with a step along ``gradient`` (n_theta,) taken."""
        return ascend(self.optimiser, state, gradient, self.rate)

    def stepped(
        self,
        experiment: Experiment,
        state: State,
        gradients: np.ndarray,
        episodes: Episodes,
        good: np.ndarray,
        k: int,
    ) -> tuple[State, Row]:
        """State after a step along the mean of ``gradients`` (n, n_theta), and iteration k's row.

        ``episodes``, of which those that are ``good`` (n,) count, carry the buffer on.
        """
        mean = gradients.mean(axis=0)
        starts = Starts.of(state)
        starts = starts.after(experiment, episodes.states, episodes.lived.astype(int), k)
        moved = {**self.climb(state, mean), **starts.arrays()}
        row = {**sample_row(episodes, good), "gradient_norm": float(np.linalg.norm(mean))}
        if len(gradients) > 1:
            row["gradient_variance"] = float(gradients.var(axis=0, ddof=1).sum())
        return normalised_state(experiment, moved, episodes, good), row


@dataclass(frozen=True, kw_only=True)
class Clipping(Unrolled):
    """Settings of one that may cut every sample's gradient to ``clip`` times their median length.

    Cutting biases the mean, whatever the estimate, and saves it from the few samples that lose
    their way; by default nothing is cut.
    """

    clip: Annotated[float | None, "largest norm of a sample's gradient, in medians of all; biases the mean"] = None

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
