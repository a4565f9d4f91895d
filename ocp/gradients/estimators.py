"""Estimators of the gradient of a smoothed objective, and rules for the weight of the first order."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from dynamics.batch import Gaussian, Moments
from dynamics.settings import Configured, setting
from ocp.errors import InputError
from ocp.gradients.chunks import Sampler, mean_cost
from ocp.gradients.objective import Bulk, SampledObjective


class Estimator(ABC):
    """One estimator of ``grad F(theta)``, F the mean of V(theta, w) over ``w ~ N(0, sigma^2 I)``.

    ``stream`` numbers the random numbers that it uses: estimators of one stream see the same
    samples, those of different streams independent ones. ``evaluations`` is how many rollouts one
    sample costs.
    """

    name: str
    summary: str
    stream: ClassVar[int]
    evaluations: int = 1

    @abstractmethod
    def make_sampler(self, objective: SampledObjective, noise: Gaussian, n: int) -> Sampler:
        """Return the sampler of single estimates; ``n`` is their total number."""

    def with_baseline(self, objective: SampledObjective, mean_cost: Callable[[], float]) -> Estimator:
        """Return the same with its baseline as a number; ``mean_cost()`` is the mean over all samples."""
        return self


@dataclass(frozen=True)
class ZeroOrder(Estimator):
    """ZoBG, the likelihood-ratio gradient (pathologies, def. II.1), with a baseline b.

    One sample is ``(V(theta, w) - b) s``, s the score. b is 0 (``none``), the cost without noise
    (``zero-noise``), or the mean cost of the other n - 1 samples (``mean``, which stays unbiased);
    ``antithetic`` is the mean of the samples at w and -w, both less the cost without noise, which
    cancels for open loop and counts under feedback, whose score is not odd in w.
    """

    name: str
    summary: str
    baseline: str = "none"
    evaluations: int = 1
    value: float | None = None
    stream: ClassVar[int] = 0

    def with_baseline(self, objective: SampledObjective, mean_cost: Callable[[], float]) -> ZeroOrder:
        """Return the same with b as a number."""
        if self.baseline == "none":
            return replace(self, value=0.0)
        return replace(self, value=mean_cost() if self.baseline == "mean" else objective.nominal_cost())

    def make_sampler(self, objective: SampledObjective, noise: Gaussian, n: int) -> Sampler:
        """Return the sampler of ``(V - b) s``, cost V, baseline b and score s; b is computed if not given.

        Raises :class:`~ocp.errors.InputError` for one sample with the mean of the others as its baseline.
        """
        factor = 1.0
        if self.baseline == "mean":
            if n < 2:
                raise InputError("the mean of the other samples needs 2 samples or more, got 1")
            # V_i less the mean of the others is n/(n-1) times V_i less the mean of all.
            factor = n / (n - 1)
        baseline = self.value
        if baseline is None:
            baseline = self.with_baseline(objective, lambda: mean_cost(objective, noise, n)).value
            assert baseline is not None

        def weighted_scores(g: Gaussian, m: int) -> np.ndarray:
            samples = objective.sample_scores(g, m)
            return (factor * (samples.cost - baseline))[:, None] * samples.direction

        def bulk(g: Gaussian, m: int) -> Bulk | None:
            sums = objective.moments(g, m, "zeroth", baseline)
            if sums is None:
                return None
            moments, nonfinite = sums
            return Moments(moments.n, factor * moments.mean, factor**2 * moments.m2), nonfinite

        if self.baseline == "antithetic":
            return Sampler(lambda g, m: (weighted_scores(g, m) + weighted_scores(g.negate(), m)) / 2)
        return Sampler(weighted_scores, bulk)


@dataclass(frozen=True)
class FirstOrder(Estimator):
    """FoBG, the pathwise gradient ``grad_theta V(theta, w)`` (pathologies, def. II.2)."""

    name: str = "fobg"
    summary: str = "first order, gradients through contact"
    stream: ClassVar[int] = 1

    def make_sampler(self, objective: SampledObjective, noise: Gaussian, n: int) -> Sampler:
        """Return the sampler of gradients; they are NaN where the cost is not finite."""

        def contributions(g: Gaussian, m: int) -> np.ndarray:
            samples = objective.sample_gradients(g, m)
            return np.where(np.isfinite(samples.cost)[:, None], samples.direction, np.nan)

        return Sampler(contributions, lambda g, m: objective.moments(g, m, "first"))


@dataclass(frozen=True)
class EvolutionStrategies(Estimator):
    """Likelihood ratio in the space of parameters (abs, sec. 7.2).

    One sample is ``(V(theta + sigma e) - V(theta - sigma e)) e / (2 sigma)`` without any other
    noise. Where the noise is added to the decision itself, or to open-loop inputs, this is the
    antithetic ZoBG; for feedback it smooths over gains, and so estimates another gradient.
    """

    name: str = "es"
    summary: str = "evolution strategies: parameters disturbed in pairs"
    stream: ClassVar[int] = 2
    evaluations: int = 2

    def make_sampler(self, objective: SampledObjective, noise: Gaussian, n: int) -> Sampler:
        """Return the sampler of antithetic differences."""

        def contributions(g: Gaussian, m: int) -> np.ndarray:
            above, below = (objective.sample_perturbed(side, m) for side in (g, g.negate()))
            return ((above.cost - below.cost) / 2)[:, None] * above.direction

        return Sampler(contributions)


_BASELINES = (
    ("zobg", "none", 1, "without baseline"),
    ("zobg-zero-noise", "zero-noise", 1, "the cost without noise as baseline"),
    ("zobg-mean", "mean", 2, "the mean cost of the other samples as baseline"),
    ("zobg-antithetic", "antithetic", 2, "pairs of samples at w and -w"),
)
"""Name, baseline, evaluations (a pair of samples, or another pass for the mean) and summary."""
SAMPLED: dict[str, Estimator] = {
    estimator.name: estimator
    for estimator in (
        *(ZeroOrder(name, f"zeroth order, {summary}", baseline, k) for name, baseline, k, summary in _BASELINES),
        FirstOrder(),
        EvolutionStrategies(),
    )
}
"""Estimators that are means of independent samples, by name."""


@dataclass(frozen=True)
class Evidence:
    """Statistics from which alpha is chosen, both estimates being means of ``n`` samples.

    ``first_variance`` and ``zeroth_variance`` are traces of the covariance of one sample;
    ``distance`` is ``|first mean - zeroth mean|``, ``gradient_size`` the size of the zeroth mean,
    ``deviation`` a bound on how far one zeroth-order sample lies from its mean; ``d`` the number of
    components.
    """

    n: int
    d: int
    first_variance: float
    zeroth_variance: float
    distance: float
    gradient_size: float
    deviation: float


@dataclass(frozen=True)
class Choice:
    """The chosen alpha in [0, 1], the weight of the *first-order* estimate, and the reason.

    ``epsilon`` and ``gamma`` are the confidence test's, NaN without such a test.
    """

    alpha: float
    reason: str
    epsilon: float = math.nan
    gamma: float = math.nan


def inverse_variance(first_variance: float, zeroth_variance: float) -> float:
    """``alpha* = s0^2 / (s0^2 + s1^2)``, which minimises ``alpha^2 s1^2 + (1 - alpha)^2 s0^2``.

    The weight of the first order; pathologies, eq. 6, writes 1 - alpha. Two estimates without
    variance give 1.
    """
    total = first_variance + zeroth_variance
    return zeroth_variance / total if total > 0 else 1.0


def bernstein_distance(n: int, d: int, variance: float, deviation: float, delta: float) -> float:
    """Bound on a mean of n samples' distance from its expectation, with probability 1 - delta.

    ``sqrt(2 s^2 l / n) + 2 L l / (3 n)`` with ``l = ln((d + 1)/delta)``: the vector Bernstein
    inequality, solved for the distance, with ``variance`` s^2 the trace and ``deviation`` L a bound
    on one sample.
    """
    log = math.log((d + 1) / delta)
    return math.sqrt(2 * variance * log / n) + 2 * deviation * log / (3 * n)


@dataclass(frozen=True)
class ConfidenceTest(Configured):
    """Weight alpha of the first order, of least variance subject to ``alpha B + epsilon <= gamma``.

    B is the distance between the two estimates and epsilon bounds the error of the zeroth order with
    failure probability ``delta``, so that the error of the interpolated gradient stays below
    ``gamma`` with probability 1 - delta (the rule of Suh, Simchowitz, Zhang and Tedrake, ICML 2022,
    used by pathologies, sec. IV-C). ``gamma`` None is a tenth of the zeroth-order gradient's size.
    ``deviation`` None takes the largest that the samples show: Gaussian noise has no certain bound.

    Their public code passes 0.95 for delta, which is the probability to *fail*; here it is 0.05.

    Raises :class:`~ocp.errors.InputError` for gamma <= 0, delta outside (0, 1), deviation < 0.
    """

    gamma: float | None = setting(
        None, "bound on the error; a tenth of the zeroth-order gradient if not given", above=0
    )
    delta: float = setting(0.05, "probability that the test fails", above=0, below=1)
    deviation: float | None = setting(None, "bound on one sample; the largest seen if not given", least=0)
    name: ClassVar[str] = "alpha"
    summary: ClassVar[str] = "both orders, weighted subject to a confidence test"

    def choose_weight(self, evidence: Evidence) -> Choice:
        """Choose alpha: 0 where the zeroth order alone is too uncertain, alpha* where the test allows it."""
        deviation = evidence.deviation if self.deviation is None else self.deviation
        epsilon = bernstein_distance(evidence.n, evidence.d, evidence.zeroth_variance, deviation, self.delta)
        gamma = 0.1 * evidence.gradient_size if self.gamma is None else self.gamma
        alpha = inverse_variance(evidence.first_variance, evidence.zeroth_variance)
        if epsilon > gamma:
            return Choice(0.0, "too few samples for the test, so zeroth order only", epsilon, gamma)
        if alpha * evidence.distance <= gamma - epsilon:
            return Choice(alpha, "inverse variance, which passes the test", epsilon, gamma)
        return Choice((gamma - epsilon) / evidence.distance, "held back by the test", epsilon, gamma)


@dataclass(frozen=True)
class InverseVariance:
    """Least variance by the empirical variances, without regard to the two estimates' distance.

    It is fooled where the first order is biased and its variance small (pathologies, sec. IV-C).
    """

    name: ClassVar[str] = "alpha-variance"
    summary: ClassVar[str] = "both orders, weighted by inverse empirical variance"

    def choose_weight(self, evidence: Evidence) -> Choice:
        """Choose ``alpha*``."""
        return Choice(inverse_variance(evidence.first_variance, evidence.zeroth_variance), "least variance")


@dataclass(frozen=True)
class FixedWeight(Configured):
    """A constant alpha in [0, 1]; raises :class:`~ocp.errors.InputError` outside."""

    alpha: float = setting(0.5, "weight of the first order", least=0, most=1)
    name: ClassVar[str] = "alpha-fixed"
    summary: ClassVar[str] = "both orders, with a constant weight"

    def choose_weight(self, evidence: Evidence) -> Choice:
        """Return the constant."""
        return Choice(self.alpha, "constant")


Rule = ConfidenceTest | InverseVariance | FixedWeight
RULES: dict[str, type[Rule]] = {rule.name: rule for rule in (ConfidenceTest, InverseVariance, FixedWeight)}
"""Rules for the weight of the first order, by name."""
