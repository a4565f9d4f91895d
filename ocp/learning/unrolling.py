"""Unrolls of the trained policy (rollouts of part of an episode), and ascent along their gradients."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from dynamics.batch import Episodes
from dynamics.contact import ContactLaw
from dynamics.settings import setting
from ocp.errors import InputError, NotConverged, choose
from ocp.learning.experiment import Experiment
from ocp.learning.protocol import Algorithm, Normaliser, Row, State, TrainedPolicy, renormalise_policy

Slope = Callable[[np.ndarray], tuple[float, np.ndarray]]
"""Function from parameters to a cost and the cost's gradient; both may be random samples."""

ADAM_DECAY = (0.9, 0.999)
"""Decay rates b1 and b2 of Adam's first and second moments."""


def adam_step(
    gradient: np.ndarray, m: np.ndarray, v: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return Adam's step number ``count`` = 1, 2, ... with rate 1, and the next m and v.

    ``m <- b1 m + (1 - b1) g``, ``v <- b2 v + (1 - b2) g²``, and the step is
    ``m/(1 - b1^t) / (sqrt(v/(1 - b2^t)) + 1e-8)`` with b1, b2 = 0.9, 0.999 (Kingma and Ba, algorithm 1).
    """
    m = ADAM_DECAY[0] * m + (1 - ADAM_DECAY[0]) * gradient
    v = ADAM_DECAY[1] * v + (1 - ADAM_DECAY[1]) * gradient**2
    mean_corrected, square_corrected = m / (1 - ADAM_DECAY[0] ** count), v / (1 - ADAM_DECAY[1] ** count)
    return mean_corrected / (np.sqrt(square_corrected) + 1e-8), m, v


def adam(slope: Slope, theta: np.ndarray, rate: float) -> Iterator[tuple[np.ndarray, float]]:
    """Minimise a cost by Adam with learning rate ``rate``: yield theta and its cost before each step, without end.

    Raises ``ValueError`` if a gradient is not finite.
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


MAX_NORMALISED_GRADIENT = 1e3
"""Absolute value of a gradient's largest entry from which normalised ascent makes no step."""

Rule = Callable[[State, np.ndarray, float], State]
"""Function from (state, gradient, rate) to the entries of the state that change, such as ``theta``."""


def ascend(rule: str, state: State, gradient: np.ndarray, rate: float) -> State:
    """Return an algorithm's state after a step of ``theta`` (n_theta,) along ``gradient`` (n_theta,).

    ``rule`` is ``adam`` (Kingma and Ba); ``normalised`` for ``theta + rate g / |g|_inf``, with no step if
    |g|_inf is 1000 or more (Dojo's augmented gradient search); or ``plain`` for ``theta + rate g`` (Zhang, Jin
    and Wang 2023, eq. 4.3). Raises :class:`~ocp.errors.InputError` for any other ``rule``.
    """
    return {**state, **choose("optimiser", rule, OPTIMISERS)(state, gradient, rate)}


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
    step = gradient / size if 0 < size < MAX_NORMALISED_GRADIENT else 0.0 * gradient
    return {"theta": state["theta"] + rate * step}


def _plain(state: State, gradient: np.ndarray, rate: float) -> State:
    return {"theta": state["theta"] + rate * gradient}


OPTIMISERS: dict[str, Rule] = {"adam": _adam, "normalised": _normalised, "plain": _plain}
"""Mapping from names to rules for a step along a gradient."""


@dataclass(frozen=True)
class Starts:
    """States ``x`` (n, nx) from which unrolls start, and the ages (n,) of their episodes in steps.

    Every unroll continues the episode of the previous unroll. An episode that has ended or reached the task's
    horizon is replaced by a new one, so unrolls as long as an episode always start a new episode.
    """

    x: np.ndarray
    age: np.ndarray

    @classmethod
    def initial(cls, experiment: Experiment, n: int, unroll: int) -> Starts:
        """Return ``n`` initial states with random ages, so that episodes do not all end at once."""
        rng, horizon = experiment.rng(0, "starts"), experiment.task.horizon
        return cls(experiment.first_states(n, rng), unroll * rng.integers(-(-horizon // unroll), size=n))

    def after(self, experiment: Experiment, states: np.ndarray, lived: np.ndarray, k: int) -> Starts:
        """Return the next starts, after unrolls with ``states`` (n, H+1, nx) that ended after ``lived`` (n,) steps."""
        n, unroll = len(states), states.shape[1] - 1
        x, age = states[np.arange(n), lived], self.age + lived
        restarted = (lived < unroll) | (age >= experiment.task.horizon) | ~np.isfinite(x).all(axis=1)
        initial_states = experiment.first_states(n, experiment.rng(k, "starts again"))
        return Starts(np.where(restarted[:, None], initial_states, x), np.where(restarted, 0, age))

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the entries of an algorithm's state that store these starts."""
        return {"starts.x": self.x, "starts.age": self.age}

    @classmethod
    def from_state(cls, state: dict[str, np.ndarray]) -> Starts:
        """Build the starts from the entries of :meth:`arrays` in an algorithm's state."""
        return cls(state["starts.x"], state["starts.age"])


def unroll_episodes(
    experiment: Experiment,
    state: State,
    x0: np.ndarray,
    horizon: int,
    *,
    theta: np.ndarray | None = None,
    law: ContactLaw | None = None,
    **options: Any,
) -> Episodes:
    """Simulate unrolls of ``horizon`` steps from ``x0`` (n, nx) under the policy of ``state``.

    ``theta`` (n, n_theta) replaces the policy's parameters, separately for each sample; ``law`` replaces the
    experiment's contact law. Physical parameters are the state's ``psi`` if it has any. ``options``, such as
    noise, gradient and score, are those of :class:`~dynamics.batch.EpisodeFunction`. Samples that are not
    finite, because of an unsolved contact or an overflow, are not removed (see :func:`finite_samples`).
    """
    episodes = experiment.rollouts(horizon, law)(
        x0,
        state["theta"] if theta is None else theta,
        Normaliser.from_state(state),
        discount=experiment.discount,
        model_params=state.get("psi", experiment.physics),
        n_samples=len(x0),
        states=True,
        **options,
    )
    experiment.count_steps(episodes.lived.sum())
    return episodes


def finite_samples(experiment: Experiment, state: State, episodes: Episodes, k: int) -> np.ndarray:
    """Return a mask (n,) of the samples with finite return, gradient and score.

    Raises :class:`~ocp.errors.InputError`, naming step and sample, if a reward is not finite at finite states,
    and :class:`~ocp.errors.NotConverged` if no sample is finite.
    """
    finite = np.isfinite(episodes.value)
    for samples in (episodes.gradient, episodes.score):
        if samples is not None:
            finite &= np.isfinite(samples).all(axis=1)
    for sample in np.flatnonzero(~np.isfinite(episodes.value)):
        if np.isfinite(episodes.states[sample]).all():
            step = _step_without_reward(experiment, TrainedPolicy.from_state(state), episodes.states[sample])
            location = f"sample {sample} in iteration {k}"
            raise InputError(non_finite_reward_message(experiment, step, location))
    if not finite.any():
        raise NotConverged(
            f"{experiment.task.name}: no sample of iteration {k} stayed finite; lower the learning"
            " rate, the noise or the unroll length"
        )
    return finite


def _step_without_reward(experiment: Experiment, policy: TrainedPolicy, states: np.ndarray) -> int:
    """Return the first step with a non-finite reward under inputs without noise, or the number of steps if none."""
    task, inputs = experiment.task, experiment.inputs(policy, states[:-1])
    for t, (x, next_state) in enumerate(pairwise(states)):
        if not np.isfinite(float(task.rewards(x, inputs[t], next_state, experiment.physics))):
            return t
    return len(states) - 1


def non_finite_reward_message(experiment: Experiment, step: int, location: str) -> str:
    """Return an error message on a non-finite reward at a step; ``location`` names the sample or episode."""
    return (
        f"{experiment.task.name}: the reward of step {step} of {location} is NaN or infinite at"
        " finite states; correct the reward or end the episode earlier"
    )


def normalised_state(experiment: Experiment, state: State, episodes: Episodes, finite: np.ndarray) -> State:
    """Return the state with the normaliser updated by samples in the mask ``finite`` (n,) and the policy unchanged."""
    steps = np.arange(episodes.states.shape[1] - 1)
    alive = finite[:, None] & (steps < episodes.lived[:, None])
    observations = experiment.observations(episodes.states[:, :-1][alive])
    return with_observations(experiment, state, observations[np.isfinite(observations).all(axis=1)])


def with_observations(experiment: Experiment, state: State, observations: np.ndarray) -> State:
    """Return the state with its normaliser updated by observations (n, n_o), and with the policy unchanged."""
    if not experiment.normalise:
        return state
    old_normaliser = Normaliser.from_state(state)
    new_normaliser = old_normaliser.after(observations)
    theta = renormalise_policy(experiment.policy, state["theta"], old_normaliser, new_normaliser)
    return {**state, **new_normaliser.arrays(), "theta": theta}


def sample_row(episodes: Episodes, finite: np.ndarray) -> Row:
    """Return the mean return of the samples in the mask ``finite`` (n,), and the number of other samples."""
    return {
        "return_mean": float(episodes.value[finite].mean()),
        "nonfinite": float((~finite).sum()),
    }


@dataclass(frozen=True, kw_only=True)
class Unrolled(Algorithm):
    """Base class of algorithms that unroll a policy and take steps along a gradient.

    Each iteration simulates ``samples`` unrolls of ``unroll`` steps (at most an episode's), which continue
    the unrolls of the last iteration. Actions before tanh have Gaussian noise of standard deviation ``sigma``. Then
    the policy takes one step with learning rate ``rate`` by ``optimiser``, a rule of
    :func:`~ocp.learning.unrolling.ascend`.
    """

    samples: int = setting(64, "unrolls per iteration", least=1)
    unroll: int = setting(32, "steps of an unroll, at most an episode's", least=1)
    sigma: float = setting(0.1, "standard deviation of the noise on the actions before tanh", above=0)
    rate: float = setting(0.01, "learning rate", above=0)
    optimiser: str = setting("adam", "rule for a step along the gradient", words=tuple(OPTIMISERS))

    def starts(self) -> int:
        """Return the number of states from which unrolls start."""
        return self.samples

    def steps(self, experiment: Experiment) -> int:
        """Return the number of steps of an unroll, which is at most the number of steps of an episode."""
        return min(self.unroll, experiment.task.horizon)

    def begin(self, experiment: Experiment) -> State:
        """Return the initial state: the policy, and the states from which unrolls start."""
        state = super().begin(experiment)
        starts = Starts.initial(experiment, self.starts(), self.steps(experiment))
        return {**state, **starts.arrays()}

    def take_step(
        self,
        experiment: Experiment,
        state: State,
        gradients: np.ndarray,
        episodes: Episodes,
        finite: np.ndarray,
        k: int,
    ) -> tuple[State, Row]:
        """Return the state after a step along the mean of ``gradients`` (n, n_theta), and the row of iteration k.

        The normaliser and the row are computed from the ``episodes`` in the mask ``finite`` (n,). The next
        unrolls start where ``episodes`` end.
        """
        mean = gradients.mean(axis=0)
        starts = Starts.from_state(state)
        starts = starts.after(experiment, episodes.states, episodes.lived.astype(int), k)
        new_state = {**ascend(self.optimiser, state, mean, self.rate), **starts.arrays()}
        row = {**sample_row(episodes, finite), "gradient_norm": float(np.linalg.norm(mean))}
        if len(gradients) > 1:
            row["gradient_variance"] = float(gradients.var(axis=0, ddof=1).sum())
        return normalised_state(experiment, new_state, episodes, finite), row


@dataclass(frozen=True, kw_only=True)
class Clipping(Unrolled):
    """Base class of algorithms that may clip each sample's gradient to ``clip`` times the median norm.

    Clipping protects the mean from a few diverging samples, but biases it; it is off by default.
    """

    clip: float | None = setting(
        None, "maximum norm of a sample's gradient, in median norms; clipping biases the mean", above=0
    )

    def clip_gradients(self, gradients: np.ndarray) -> np.ndarray:
        """Return ``gradients`` (n, n_theta) clipped to ``clip`` times their median norm."""
        if self.clip is None:
            return gradients
        lengths = np.linalg.norm(gradients, axis=1)
        max_length = self.clip * np.median(lengths)
        return gradients * np.minimum(1.0, max_length / np.maximum(lengths, 1e-300))[:, None]
