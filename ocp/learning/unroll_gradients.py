"""Policy-gradient algorithms of first, zeroth and mixed order on unrolls, and augmented random search."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from dynamics.batch import Episodes
from dynamics.contact import Barrier
from dynamics.settings import setting
from ocp.errors import InputError
from ocp.gradients.estimators import bernstein_distance, inverse_variance
from ocp.learning.critic import Critic
from ocp.learning.experiment import Experiment
from ocp.learning.protocol import Algorithm, Row, State
from ocp.learning.unrolling import Clipping, Unrolled, finite_samples, normalised_state, sample_row, unroll_episodes


@dataclass(frozen=True, kw_only=True)
class ZOPG(Clipping):
    """Zeroth-order policy gradient, by the likelihood ratio ``g = mean of (V - b) sum_t D_theta a_t' w_t / sigma²``.

    V is the return of an unroll. Every start is unrolled twice, with the noise w and -w, which gives
    ``samples`` unrolls in total; the baseline b is the mean return of all other pairs. The estimate is unbiased
    unless gradients are clipped.
    """

    name: ClassVar[str] = "zopg"
    summary: ClassVar[str] = "likelihood-ratio policy gradient, antithetic, with a baseline"
    contact: ClassVar[str] = "exact"

    samples: int = setting(256, "unrolls per iteration, in pairs of noise w and -w", least=4)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.samples % 2:
            raise InputError(f"samples come in pairs of w and -w: {self.samples} is odd")

    def starts(self) -> int:
        """Return the number of states from which unrolls start, one for each pair."""
        return self.samples // 2

    def iterate(self, experiment: Experiment, state: State, k: int) -> tuple[State, Row]:
        """Unroll pairs of episodes and take one step along the mean of their gradients."""
        steps = self.steps(experiment)
        noise = experiment.noise(self.sigma, k, "actions")
        pair = [
            unroll_episodes(experiment, state, state["starts.x"], steps, noise=signed_noise, score=True)
            for signed_noise in (noise, noise.negate())
        ]
        finite = np.logical_and(*(finite_samples(experiment, state, episodes, k) for episodes in pair))
        gradients = self.clip_gradients(likelihood_ratio(pair, finite))
        return self.take_step(experiment, state, gradients, pair[0], finite, k)


def likelihood_ratio(batches: Sequence[Episodes], finite: np.ndarray) -> np.ndarray:
    """Return likelihood-ratio gradients (n, n_theta): ``(V - b) score`` averaged over batches.

    Sample i of each batch has the same start. Only samples in the mask ``finite`` are used. The baseline b of a
    sample is the mean return of all other samples in all batches. Raises :class:`~ocp.errors.InputError` for
    fewer than two samples.
    """
    values = np.stack([batch.value[finite] for batch in batches])
    if values.shape[1] < 2:
        raise InputError(
            "a likelihood ratio with a baseline needs two samples that stay finite, there are"
            f" {values.shape[1]}; take more samples or less noise"
        )
    means = values.mean(axis=0)
    baseline = (means.sum() - means) / (len(means) - 1)
    scores = np.stack([np.asarray(batch.score)[finite] for batch in batches])
    return ((values - baseline)[..., None] * scores).mean(axis=0)


SHARP_LAW = Barrier(mu=1e-10)
"""Barrier law that replaces exact contact where gradients are needed (Zhang, Jin and Wang 2023, sec. 7.4)."""

SMOOTHINGS = {
    "rollout": "states and gradient of the experiment's law",
    "gradient": "states of mu = 1e-10, and the gradient along them of the experiment's law",
}
"""Mapping from values of FOPG's setting ``smoothing`` to their descriptions."""


@dataclass(frozen=True, kw_only=True)
class FOPG(Clipping):
    """First-order policy gradient: the mean gradient of unrolled returns through the contact model.

    Source: Zhang, Jin and Wang (2023), eq. 4.2 and 4.3. With ``smoothing="rollout"``, states and gradient are
    computed under the experiment's law. With ``"gradient"``, states are computed under the barrier law with mu
    = 1e-10, and the experiment's law is used only to linearise along them (their algorithm 2). If ``critic`` is
    not 0, a critic with that number of units per layer is trained, and its value of the last state of an unroll
    is added to the return (:class:`~ocp.learning.critic.Critic`).
    """

    name: ClassVar[str] = "fopg"
    summary: ClassVar[str] = "first-order policy gradient through the contact model"
    contact: ClassVar[str] = "adaptive"

    smoothing: str = setting(
        "rollout", "what the law smooths: states and gradient, or the gradient alone", words=tuple(SMOOTHINGS)
    )
    critic: int = setting(0, "units in each layer of a critic; 0 for none", least=0)

    @property
    def value_critic(self) -> Critic | None:
        """The critic, or None if it has 0 units."""
        return Critic(units=self.critic) if self.critic else None

    def check(self, experiment: Experiment) -> None:
        """Raise :class:`~ocp.errors.InputError` if settings do not fit, or a critic could not be learned."""
        super().check(experiment)
        if critic := self.value_critic:
            critic.check(experiment, self.steps(experiment))

    def begin(self, experiment: Experiment) -> State:
        """Return the initial state, including the entries of the critic if there is one."""
        state, critic = super().begin(experiment), self.value_critic
        return {**state, **critic.begin(experiment)} if critic else state

    def iterate(self, experiment: Experiment, state: State, k: int) -> tuple[State, Row]:
        """Unroll episodes and take one step along their mean gradient, then train the critic."""
        x0, steps, critic = state["starts.x"], self.steps(experiment), self.value_critic
        noise = experiment.noise(self.sigma, k, "actions")
        sharp_rollout = terminal_gradient = None
        if self.smoothing == "gradient":
            sharp_rollout = unroll_episodes(experiment, state, x0, steps, law=SHARP_LAW, noise=noise)
        if critic:
            rollout = sharp_rollout or unroll_episodes(experiment, state, x0, steps, noise=noise)
            terminal_gradient = critic.terminal_gradient(experiment, state, rollout)
        episodes = unroll_episodes(
            experiment,
            state,
            x0,
            steps,
            noise=noise,
            gradient=True,
            linearise_along=sharp_rollout,
            terminal_gradient=terminal_gradient,
        )
        finite = finite_samples(experiment, state, episodes, k)
        assert episodes.gradient is not None
        gradients = self.clip_gradients(episodes.gradient[finite])
        visited_episodes = episodes if sharp_rollout is None else sharp_rollout
        changed, row = self.take_step(experiment, state, gradients, visited_episodes, finite, k)
        if critic:
            critic_state, critic_row = critic.learn(experiment, state, changed, visited_episodes, noise, k)
            changed, row = {**changed, **critic_state}, {**row, **critic_row}
        return changed, row


@dataclass(frozen=True, kw_only=True)
class AoBG(Unrolled):
    """Policy gradient ``g = alpha g1 + (1 - alpha) g0`` of mixed first and zeroth order (alpha-order batched gradient).

    alpha is the weight of the *first* order (:func:`mixing_weight`). g1 and g0 are computed from two
    independent batches of ``samples``. With probability 1 - ``delta``, |g - E g0| is at most ``gamma``. If
    there are too few samples to bound even the error of g0 by gamma, alpha is 0. The unit of gamma is the unit of the
    return divided by the unit of theta, so that no value fits all tasks. Source: Suh, Simchowitz, Zhang and Tedrake
    (ICML 2022), algorithm 1.
    """

    name: ClassVar[str] = "aobg"
    summary: ClassVar[str] = "alpha-order batched gradient, first and zeroth order mixed"
    contact: ClassVar[str] = "exact"

    samples: int = setting(64, "unrolls per iteration", hint="a variance needs two", least=2)
    gamma: float = setting(1.0, "bound on the gradient's error", "return / unit of theta", above=0)
    delta: float = setting(0.05, "probability that the test fails", above=0, below=1)

    def iterate(self, experiment: Experiment, state: State, k: int) -> tuple[State, Row]:
        """Unroll two batches of episodes and take one step along the mixed gradient."""
        x0, steps = state["starts.x"], self.steps(experiment)
        noises = [experiment.noise(self.sigma, k, order) for order in ("first", "zeroth")]
        first = unroll_episodes(experiment, state, x0, steps, noise=noises[0], gradient=True)
        zeroth = unroll_episodes(experiment, state, x0, steps, noise=noises[1], score=True)
        finite = finite_samples(experiment, state, first, k)
        assert first.gradient is not None
        gradients = (
            first.gradient[finite],
            likelihood_ratio([zeroth], finite_samples(experiment, state, zeroth, k)),
        )
        alpha, bias = mixing_weight(gradients[0], gradients[1], self.gamma, self.delta)
        g1, g0 = (samples.mean(axis=0) for samples in gradients)
        mixed_gradient = alpha * g1 + (1 - alpha) * g0
        changed, row = self.take_step(experiment, state, mixed_gradient[None], first, finite, k)
        variance = sum(
            weight**2 * float(samples.var(axis=0, ddof=1).sum())
            for weight, samples in zip((alpha, 1 - alpha), gradients, strict=True)
        )
        return changed, {**row, "gradient_variance": variance, "alpha": alpha, "bias": bias}


def mixing_weight(first: np.ndarray, zeroth: np.ndarray, gamma: float, delta: float) -> tuple[float, float]:
    """Return the weight alpha of first-order gradients, and the distance B = |g1 - g0| of both means.

    ``first`` (n, d) and ``zeroth`` (m, d) are samples of first- and zeroth-order gradients, with means g1 and
    g0. The variance of the mixture is smallest for ``alpha* = s0² / (s0² + s1²)``, where s1² and s0² are the
    variances of g1 and g0. The bias is at most gamma with probability 1 - delta if ``alpha B + eps <= gamma``,
    where eps bounds the error of the zeroth-order mean (:func:`~ocp.gradients.estimators.bernstein_distance`,
    with the largest deviation in the batch). So alpha is alpha* if alpha* satisfies this condition, else (gamma
    - eps) / B, and 0 if eps > gamma.
    """
    (n, d), m = first.shape, len(zeroth)
    g1, g0 = first.mean(axis=0), zeroth.mean(axis=0)
    v1, v0 = (float(samples.var(axis=0, ddof=1).sum()) for samples in (first, zeroth))
    largest = float(np.linalg.norm(zeroth - g0, axis=1).max())
    eps = bernstein_distance(m, d, v0, largest, delta)
    bias, variance_weight = float(np.linalg.norm(g1 - g0)), inverse_variance(v1 / n, v0 / m)
    if eps > gamma:
        return 0.0, bias
    return (variance_weight if variance_weight * bias <= gamma - eps else (gamma - eps) / bias), bias


@dataclass(frozen=True, kw_only=True)
class ARS(Algorithm):
    """Augmented random search, variant V2-t of Mania, Guy and Recht (2018), with normalised observations.

    ``theta <- theta + rate / (top sigma_R) sum_i (r_i+ - r_i-) delta_i``, where r_i± are the returns of whole
    episodes at ``theta ± spread delta_i`` from the same start. Of ``directions`` random directions delta_i ~
    N(0, 1), the sum uses the ``top`` directions with the largest max(r_i+, r_i-); sigma_R is the standard deviation
    of their returns. Parameters that do not affect the return are not changed. An episode with non-finite
    states counts with the smallest finite return.
    """

    name: ClassVar[str] = "ars"
    summary: ClassVar[str] = "augmented random search, V2-t"
    contact: ClassVar[str] = "exact"

    directions: int = setting(16, "random directions per iteration", least=1)
    top: int = setting(8, "best directions used", least=1)
    spread: float = setting(0.1, "step along each direction", above=0)
    rate: float = setting(0.05, "length of a step", above=0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.top > self.directions:
            raise InputError(f"top is {self.top}, more than the {self.directions} directions; take fewer")

    def iterate(self, experiment: Experiment, state: State, k: int) -> tuple[State, Row]:
        """Simulate episodes in random directions of theta, and take one step along the best directions."""
        theta, n = state["theta"], self.directions
        acts = experiment.rollouts(experiment.task.horizon).function.acting[1]
        delta = acts * experiment.rng(k, "directions").standard_normal((n, theta.size))
        starts = experiment.first_states(n, experiment.rng(k, "starts"))
        episodes = unroll_episodes(
            experiment,
            state,
            np.vstack([starts, starts]),
            experiment.task.horizon,
            theta=theta + self.spread * np.vstack([delta, -delta]),
        )
        finite = finite_samples(experiment, state, episodes, k)
        returns = np.where(finite, episodes.value, episodes.value[finite].min()).reshape(2, n)
        change = self.rate * search_direction(returns, delta, self.top)
        row = {
            **sample_row(episodes, finite),
            "gradient_norm": float(np.linalg.norm(change)) / self.rate,
        }
        new_state = {**state, "theta": theta + change}
        return normalised_state(experiment, new_state, episodes, finite), row


def search_direction(returns: np.ndarray, delta: np.ndarray, top: int) -> np.ndarray:
    """Return the step ``sum (r+ - r-) delta / (top sigma_R)`` (n_theta,) from returns (2, n) and directions delta."""
    best_directions = np.argsort(-returns.max(axis=0), kind="stable")[:top]
    best_returns = returns[:, best_directions]
    deviation = best_returns.std()
    if deviation == 0:
        return np.zeros(delta.shape[1])
    return (best_returns[0] - best_returns[1]) @ delta[best_directions] / (top * deviation)
