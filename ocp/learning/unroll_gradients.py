"""Steps uphill from unrolls: first and zeroth order, both mixed, and augmented random search."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from dynamics.batch import Episodes
from dynamics.contact import Barrier
from ocp.errors import InputError, choose
from ocp.gradients.estimators import bernstein_distance, inverse_variance
from ocp.learning.critic import Critic
from ocp.learning.experiment import Experiment, at_least, positive
from ocp.learning.protocol import Algorithm, Row, State
from ocp.learning.unrolling import Clipping, Unrolled, finite_samples, normalised_state, roll, sample_row


@dataclass(frozen=True, kw_only=True)
class ZOPG(Clipping):
    """``g = mean of (V - b) sum_t D_theta a_t' w_t / sigma²``, the likelihood ratio's gradient.

    Every start is unrolled under noise w and -w, ``samples`` unrolls in all; b is the mean return
    of the others but the pair. The estimate is unbiased, unless ``clip`` cuts it.
    """

    name: ClassVar[str] = "zopg"
    summary: ClassVar[str] = "likelihood-ratio policy gradient, antithetic, with a baseline"
    contact: ClassVar[str] = "exact"

    samples: Annotated[int, "unrolls per iteration, in pairs of noise w and -w"] = 256
    least: ClassVar[int] = 4

    def check(self, experiment: Experiment) -> None:
        """As all, and that samples come in pairs."""
        super().check(experiment)
        if self.samples % 2:
            raise InputError(f"samples come in pairs of w and -w: {self.samples} is odd")

    def starts(self) -> int:
        """One for each pair."""
        return self.samples // 2

    def iterate(self, experiment: Experiment, state: State, k: int) -> tuple[State, Row]:
        """One step along the mean of the pairs."""
        steps = self.steps(experiment)
        noise = experiment.noise(self.sigma, k, "actions")
        pair = [
            roll(experiment, state, state["starts.x"], steps, noise=each, score=True)
            for each in (noise, noise.mirrored())
        ]
        good = np.logical_and(*(finite_samples(experiment, state, each, k) for each in pair))
        gradients = self.clipped(likelihood_ratio(pair, good))
        return self.stepped(experiment, state, gradients, pair[0], good, k)


def likelihood_ratio(batches: Sequence[Episodes], good: np.ndarray) -> np.ndarray:
    """``mean over batches of (V - b) score``, (n, n_theta), of the samples that are ``good``.

    The baseline b of a sample is the mean return, over the batches, of all others.

    Raises :class:`~ocp.errors.InputError` where fewer than two are left for that.
    """
    values = np.stack([each.value[good] for each in batches])
    if values.shape[1] < 2:
        raise InputError(
            "a likelihood ratio with a baseline needs two samples that stay finite, there are"
            f" {values.shape[1]}; take more samples or less noise"
        )
    means = values.mean(axis=0)
    baseline = (means.sum() - means) / (len(means) - 1)
    scores = np.stack([np.asarray(each.score)[good] for each in batches])
    return ((values - baseline)[..., None] * scores).mean(axis=0)


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
    last state of an unroll is gained there (:class:`~ocp.learning.critic.Critic`).
    """

    name: ClassVar[str] = "fopg"
    summary: ClassVar[str] = "first-order policy gradient through the contact model"
    contact: ClassVar[str] = "adaptive"

    smoothing: Annotated[str, "rollout: states and gradient are the law's; gradient: the gradient alone"] = "rollout"
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
        found = roll(experiment, state, x0, steps, noise=noise, gradient=True, along=followed, pull=pull)
        good = finite_samples(experiment, state, found, k)
        assert found.gradient is not None
        gradients = self.clipped(found.gradient[good])
        visited = found if followed is None else followed
        changed, row = self.stepped(experiment, state, gradients, visited, good, k)
        if critic:
            learned, more = critic.learned(experiment, state, changed, visited, noise, k)
            changed, row = {**changed, **learned}, {**row, **more}
        return changed, row


@dataclass(frozen=True, kw_only=True)
class AoBG(Unrolled):
    """``g = alpha g1 + (1 - alpha) g0``, alpha the weight of the *first* order (:func:`mixing`).

    g1 and g0 are of two independent batches of ``samples``. ``gamma`` bounds |g - E g0| and fails
    with probability ``delta``; where ``samples`` are too few to tell that of g0 itself, alpha is 0.
    It is the user's to choose, in units of return over those of theta: no value fits all tasks.

    Source: Suh, Simchowitz, Zhang and Tedrake (ICML 2022), algorithm 1.
    """

    name: ClassVar[str] = "aobg"
    summary: ClassVar[str] = "alpha-order batched gradient, first and zeroth order mixed"
    contact: ClassVar[str] = "exact"

    gamma: Annotated[float, "bound on the gradient's error [return / unit of theta]"] = 1.0
    delta: Annotated[float, "probability that the test fails"] = 0.05
    least: ClassVar[int] = 2

    def check(self, experiment: Experiment) -> None:
        """As all, the bound and its probability."""
        super().check(experiment)
        positive("gamma", self.gamma)
        if not 0 < self.delta < 1:
            raise InputError(f"delta is a probability between 0 and 1, got {self.delta:g}")

    def iterate(self, experiment: Experiment, state: State, k: int) -> tuple[State, Row]:
        """One step along the mixture."""
        x0, steps = state["starts.x"], self.steps(experiment)
        noises = [experiment.noise(self.sigma, k, order) for order in ("first", "zeroth")]
        first = roll(experiment, state, x0, steps, noise=noises[0], gradient=True)
        zeroth = roll(experiment, state, x0, steps, noise=noises[1], score=True)
        good = finite_samples(experiment, state, first, k)
        assert first.gradient is not None
        gradients = (
            first.gradient[good],
            likelihood_ratio([zeroth], finite_samples(experiment, state, zeroth, k)),
        )
        alpha, bias = mixing(gradients[0], gradients[1], self.gamma, self.delta)
        g1, g0 = (each.mean(axis=0) for each in gradients)
        mixed = alpha * g1 + (1 - alpha) * g0
        changed, row = self.stepped(experiment, state, mixed[None], first, good, k)
        variance = sum(
            weight**2 * float(each.var(axis=0, ddof=1).sum())
            for weight, each in zip((alpha, 1 - alpha), gradients, strict=True)
        )
        return changed, {**row, "gradient_variance": variance, "alpha": alpha, "bias": bias}


def mixing(first: np.ndarray, zeroth: np.ndarray, gamma: float, delta: float) -> tuple[float, float]:
    """Weight alpha of ``first`` (n, d) against ``zeroth`` (m, d), samples, and B = |g1 - g0|.

    ``alpha* = s0² / (s0² + s1²)``, the variances of both means, minimises the variance. The bias is
    at most gamma with probability 1 - delta where ``alpha B + eps <= gamma``, with the bound eps of
    the zeroth order's mean (:func:`~ocp.gradients.estimators.bernstein_distance`) by the largest
    deviation in the batch: alpha = alpha* where that holds, (gamma - eps) / B where not, and 0
    where eps > gamma.
    """
    (n, d), m = first.shape, len(zeroth)
    g1, g0 = first.mean(axis=0), zeroth.mean(axis=0)
    v1, v0 = (float(each.var(axis=0, ddof=1).sum()) for each in (first, zeroth))
    largest = float(np.linalg.norm(zeroth - g0, axis=1).max())
    eps = bernstein_distance(m, d, v0, largest, delta)
    bias, best = float(np.linalg.norm(g1 - g0)), inverse_variance(v1 / n, v0 / m)
    if eps > gamma:
        return 0.0, bias
    return (best if best * bias <= gamma - eps else (gamma - eps) / bias), bias


@dataclass(frozen=True, kw_only=True)
class ARS(Algorithm):
    """V2-t of Mania, Guy and Recht (2018): normalised observations, top directions, sigma_R.

    ``theta <- theta + rate / (top sigma_R) sum_i (r_i+ - r_i-) delta_i`` over the ``top`` of
    ``directions`` delta_i ~ N(0, 1) by max(r_i+, r_i-), with returns r_i± of whole episodes at
    ``theta ± spread delta_i`` from the same start, and sigma_R their standard deviation over the 2
    top used. Parameters without a way to the return stay as they are. An episode that is not finite
    counts as the worst finite one.
    """

    name: ClassVar[str] = "ars"
    summary: ClassVar[str] = "augmented random search, V2-t"
    contact: ClassVar[str] = "exact"

    directions: Annotated[int, "random directions per iteration"] = 16
    top: Annotated[int, "best directions used"] = 8
    spread: Annotated[float, "step along each direction"] = 0.1
    rate: Annotated[float, "length of a step"] = 0.05

    def check(self, experiment: Experiment) -> None:
        """Raise :class:`~ocp.errors.InputError` for settings that cannot be."""
        at_least(1, "directions", self.directions)
        at_least(1, "top", self.top)
        if self.top > self.directions:
            raise InputError(f"top is {self.top}, more than the {self.directions} directions; take fewer")
        positive("spread", self.spread)
        positive("rate", self.rate)

    def iterate(self, experiment: Experiment, state: State, k: int) -> tuple[State, Row]:
        """One step along the best directions."""
        theta, n = state["theta"], self.directions
        acts = experiment.rollouts(experiment.task.horizon).function.acting[1]
        delta = acts * experiment.rng(k, "directions").standard_normal((n, theta.size))
        starts = experiment.first_states(n, experiment.rng(k, "starts"))
        found = roll(
            experiment,
            state,
            np.vstack([starts, starts]),
            experiment.task.horizon,
            theta=theta + self.spread * np.vstack([delta, -delta]),
        )
        good = finite_samples(experiment, state, found, k)
        returns = np.where(good, found.value, found.value[good].min()).reshape(2, n)
        change = self.rate * search_direction(returns, delta, self.top)
        row = {
            **sample_row(found, good),
            "gradient_norm": float(np.linalg.norm(change)) / self.rate,
        }
        moved = {**state, "theta": theta + change}
        return normalised_state(experiment, moved, found, good), row


def search_direction(returns: np.ndarray, delta: np.ndarray, top: int) -> np.ndarray:
    """``sum (r+ - r-) delta / (top sigma_R)`` of returns (2, n) and directions (n, n_theta)."""
    chosen = np.argsort(-returns.max(axis=0), kind="stable")[:top]
    used = returns[:, chosen]
    deviation = used.std()
    if deviation == 0:
        return np.zeros(delta.shape[1])
    return (used[0] - used[1]) @ delta[chosen] / (top * deviation)
