"""Estimators of a smoothed objective's gradient, and rules that weight first- and zeroth-order estimates."""

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
    """Base class of estimators of ``grad F(theta)``, where F is the mean of V(theta, w), ``w ~ N(0, sigma^2 I)``.

    ``stream`` is the index of the estimator's random stream. Estimators with the same stream use the same
    noise, and estimators with different streams use independent noise. ``evaluations`` is the number of
    rollouts per sample.
    """

    name: str
    summary: str
    stream: ClassVar[int]
    evaluations: int = 1

    @abstractmethod
    def make_sampler(self, objective: SampledObjective, noise: Gaussian, n: int) -> Sampler:
        """Return a sampler of the estimator; ``n`` is the total number of samples."""

    def with_baseline(self, objective: SampledObjective, mean_cost: Callable[[], float]) -> Estimator:
        """Return the estimator with its baseline computed; ``mean_cost()`` returns the mean cost over all samples."""
        return self


@dataclass(frozen=True)
class ZeroOrder(Estimator):
    """Zeroth-order batched gradient (ZoBG), the likelihood-ratio gradient, with a baseline b.

    A sample is ``(V(theta, w) - b) s`` with the score s (Suh, Simchowitz, Zhang et al. 2022, def. II.1). b is 0
    (``none``), the cost without noise (``zero-noise``), or the mean cost of the other n - 1 samples (``mean``,
    which is unbiased). ``antithetic`` averages the samples at w and -w, and uses the cost without noise as b.
    This b has an effect only under feedback, because otherwise the score is odd in w.
    """

    name: str
    summary: str
    baseline: str = "none"
    evaluations: int = 1
    value: float | None = None
    stream: ClassVar[int] = 0

    def with_baseline(self, objective: SampledObjective, mean_cost: Callable[[], float]) -> ZeroOrder:
        """Return the estimator with its baseline b computed."""
        if self.baseline == "none":
            return replace(self, value=0.0)
        return replace(self, value=mean_cost() if self.baseline == "mean" else objective.nominal_cost())

    def make_sampler(self, objective: SampledObjective, noise: Gaussian, n: int) -> Sampler:
        """Return a sampler of ``(V - b) s`` with cost V, baseline b and score s; b is computed if not yet known.

        Raises :class:`~ocp.errors.InputError` if n is 1 and the baseline is the mean of the other samples.
        """
        factor = 1.0
        if self.baseline == "mean":
            if n < 2:
                raise InputError("the mean of the other samples needs 2 samples or more, got 1")
            # V_i minus the mean of the others is n/(n-1) times V_i minus the mean of all.
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
    """First-order batched gradient (FoBG), mean of ``grad_theta V`` (Suh, Simchowitz, Zhang et al. 2022, def. II.2)."""

    name: str = "fobg"
    summary: str = "first order, gradients through contact"
    stream: ClassVar[int] = 1

    def make_sampler(self, objective: SampledObjective, noise: Gaussian, n: int) -> Sampler:
        """Return a sampler of gradients, which are NaN if the cost is not finite."""

        def contributions(g: Gaussian, m: int) -> np.ndarray:
            samples = objective.sample_gradients(g, m)
            return np.where(np.isfinite(samples.cost)[:, None], samples.direction, np.nan)

        return Sampler(contributions, lambda g, m: objective.moments(g, m, "first"))


@dataclass(frozen=True)
class EvolutionStrategies(Estimator):
    """Evolution strategies: likelihood ratio with noise on the parameters (Zhang, Jin and Wang 2023, sec. 7.2).

    A sample is ``(V(theta + sigma e) - V(theta - sigma e)) e / (2 sigma)``, without noise on the inputs. For
    open-loop inputs and for objectives without dynamics this equals the antithetic ZoBG. For feedback the cost
    is smoothed over the gains instead of the inputs, so the gradient of a different function is estimated.
    """

    name: str = "es"
    summary: str = "evolution strategies: parameters disturbed in pairs"
    stream: ClassVar[int] = 2
    evaluations: int = 2

    def make_sampler(self, objective: SampledObjective, noise: Gaussian, n: int) -> Sampler:
        """Return a sampler of antithetic differences of the cost."""

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
"""Zeroth-order estimators: name, baseline, evaluations per sample, and summary."""
SAMPLED: dict[str, Estimator] = {
    estimator.name: estimator
    for estimator in (
        *(ZeroOrder(name, f"zeroth order, {summary}", baseline, k) for name, baseline, k, summary in _BASELINES),
        FirstOrder(),
        EvolutionStrategies(),
    )
}
"""Mapping from names to the estimators that are means of independent samples."""


@dataclass(frozen=True)
class Evidence:
    """Statistics of two estimates, each a mean of ``n`` samples, from which the weight alpha is chosen.

    ``d`` is the number of components. ``first_variance`` and ``zeroth_variance`` are traces of the covariance
    of one sample. ``distance`` is the norm of the difference of the two means, and ``gradient_size`` the norm
    of the zeroth-order mean. ``deviation`` bounds the distance of a zeroth-order sample from its mean.
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
    """The chosen weight alpha in [0, 1] of the *first-order* estimate, and the reason.

    ``epsilon`` and ``gamma`` are the two bounds in :class:`ConfidenceTest`, and NaN for other rules.
    """

    alpha: float
    reason: str
    epsilon: float = math.nan
    gamma: float = math.nan


def inverse_variance(first_variance: float, zeroth_variance: float) -> float:
    """Return the first-order weight ``alpha* = s0^2 / (s0^2 + s1^2)``, which minimises the variance.

    The variance is ``alpha^2 s1^2 + (1 - alpha)^2 s0^2``; alpha* is 1 if both variances are 0. In Suh,
    Simchowitz, Zhang et al. (2022), eq. 6, alpha is the weight of the zeroth-order estimate instead.
    """
    total = first_variance + zeroth_variance
    return zeroth_variance / total if total > 0 else 1.0


def bernstein_distance(n: int, d: int, variance: float, deviation: float, delta: float) -> float:
    """Return a bound, with probability 1 - delta, on the distance of the mean of n samples from its expectation.

    The bound is ``sqrt(2 s^2 l / n) + 2 L l / (3 n)`` with ``l = ln((d + 1)/delta)``, which is the vector
    Bernstein inequality solved for the distance. ``variance`` s^2 is the trace of one sample's covariance, and
    ``deviation`` L bounds the distance of one sample from the mean.
    """
    log = math.log((d + 1) / delta)
    return math.sqrt(2 * variance * log / n) + 2 * deviation * log / (3 * n)


@dataclass(frozen=True)
class ConfidenceTest(Configured):
    """Rule for the first-order weight alpha: minimum variance subject to ``alpha B + epsilon <= gamma``.

    B is the distance between the two estimates, and epsilon bounds the error of the zeroth-order estimate with failure
    probability ``delta``, so that the error of the interpolated gradient is below ``gamma`` with probability 1
    - delta. This is the rule of Suh, Simchowitz, Zhang and Tedrake (ICML 2022), also used in Suh, Simchowitz,
    Zhang et al. (2022), sec. IV-C. If ``gamma`` is None, a tenth of the zeroth-order gradient's norm is used.
    If ``deviation`` is None, the largest deviation among the samples is used, since Gaussian noise is
    unbounded. The default failure probability is 0.05; the authors' public code uses 0.95.

    Raises :class:`~ocp.errors.InputError` if gamma <= 0, delta is outside (0, 1), or deviation < 0.
    """

    gamma: float | None = setting(None, "bound on the error; by default a tenth of the zeroth-order gradient", above=0)
    delta: float = setting(0.05, "probability that the test fails", above=0, below=1)
    deviation: float | None = setting(None, "bound on one sample; by default the largest sampled norm", least=0)
    name: ClassVar[str] = "alpha"
    summary: ClassVar[str] = "both orders, weighted subject to a confidence test"

    def choose_weight(self, evidence: Evidence) -> Choice:
        """Choose alpha: 0 if the zeroth-order estimate is too uncertain, else alpha* reduced until the test holds."""
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
    """Rule for the weight of minimum variance, from empirical variances and without a test for bias.

    The weight is too large if the first-order estimate is biased and has a small variance (Suh, Simchowitz,
    Zhang et al. 2022, sec. IV-C).
    """

    name: ClassVar[str] = "alpha-variance"
    summary: ClassVar[str] = "both orders, weighted by inverse empirical variance"

    def choose_weight(self, evidence: Evidence) -> Choice:
        """Choose the weight ``alpha*`` that minimises the variance."""
        return Choice(inverse_variance(evidence.first_variance, evidence.zeroth_variance), "least variance")


@dataclass(frozen=True)
class FixedWeight(Configured):
    """Rule with a constant first-order weight alpha; raises :class:`~ocp.errors.InputError` outside [0, 1]."""

    alpha: float = setting(0.5, "weight of the first order", least=0, most=1)
    name: ClassVar[str] = "alpha-fixed"
    summary: ClassVar[str] = "both orders, with a constant weight"

    def choose_weight(self, evidence: Evidence) -> Choice:
        """Return the constant weight for any evidence."""
        return Choice(self.alpha, "constant")


Rule = ConfidenceTest | InverseVariance | FixedWeight
RULES: dict[str, type[Rule]] = {rule.name: rule for rule in (ConfidenceTest, InverseVariance, FixedWeight)}
"""Mapping from names to rules that choose the weight of the first-order estimate."""
