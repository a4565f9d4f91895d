"""The alpha-order gradient: how much weight the first-order estimate may have."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar

from ocp.errors import InputError


@dataclass(frozen=True)
class Evidence:
    """What the choice of alpha is made from, both estimates being means of ``n`` samples.

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
    """The chosen alpha in [0, 1], the weight of the *first-order* estimate, and why.

    ``epsilon`` and ``gamma`` are those of the confidence test, NaN where there was none.
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


def bernstein(n: int, d: int, variance: float, deviation: float, delta: float) -> float:
    """Distance that a mean of n samples keeps from its expectation with probability 1 - delta.

    ``sqrt(2 s^2 l / n) + 2 L l / (3 n)`` with ``l = ln((d + 1)/delta)``: the vector Bernstein
    inequality, solved for the distance, with ``variance`` s^2 the trace and ``deviation`` L a bound
    on one sample.
    """
    log = math.log((d + 1) / delta)
    return math.sqrt(2 * variance * log / n) + 2 * deviation * log / (3 * n)


@dataclass(frozen=True)
class ConfidenceTest:
    """Least variance subject to ``alpha B + epsilon <= gamma``.

    B is the distance of the two estimates and epsilon bounds the error of the zeroth order with
    failure probability ``delta``, so that the error of the interpolated gradient stays below
    ``gamma`` with probability 1 - delta (the rule of Suh, Simchowitz, Zhang and Tedrake, ICML 2022,
    used by pathologies, sec. IV-C). ``gamma`` None is a tenth of the zeroth-order gradient's size.
    ``deviation`` None takes the largest that the samples show: Gaussian noise has no certain bound.

    Their public code passes 0.95 for delta, which is the probability to *fail*; here it is 0.05.

    Raises :class:`~ocp.errors.InputError` for gamma <= 0, delta outside (0, 1), deviation < 0.
    """

    gamma: Annotated[
        float | None, "bound on the error; a tenth of the zeroth-order gradient if not given"
    ] = None
    delta: Annotated[float, "probability that the test fails"] = 0.05
    deviation: Annotated[float | None, "bound on one sample; the largest seen if not given"] = None
    name: ClassVar[str] = "alpha"
    summary: ClassVar[str] = "both orders, weighted subject to a confidence test"

    def __post_init__(self) -> None:
        if self.gamma is not None and not (math.isfinite(self.gamma) and self.gamma > 0):
            raise InputError(f"alpha: gamma must be positive and finite, got {self.gamma}")
        if not 0 < self.delta < 1:
            raise InputError(
                f"alpha: delta, the probability that the test fails, must lie between 0 and 1,"
                f" got {self.delta}"
            )
        if self.deviation is not None and not self.deviation >= 0:
            raise InputError(f"alpha: deviation must be 0 or more, got {self.deviation}")

    def choose(self, seen: Evidence) -> Choice:
        """Choose alpha: 0 where the zeroth order alone is not sure enough, alpha* where allowed."""
        deviation = seen.deviation if self.deviation is None else self.deviation
        epsilon = bernstein(seen.n, seen.d, seen.zeroth_variance, deviation, self.delta)
        gamma = 0.1 * seen.gradient_size if self.gamma is None else self.gamma
        alpha = inverse_variance(seen.first_variance, seen.zeroth_variance)
        if epsilon > gamma:
            return Choice(0.0, "too few samples for the test, so zeroth order only", epsilon, gamma)
        if alpha * seen.distance <= gamma - epsilon:
            return Choice(alpha, "inverse variance, which passes the test", epsilon, gamma)
        held = (gamma - epsilon) / seen.distance
        return Choice(held, "held back by the test", epsilon, gamma)


@dataclass(frozen=True)
class InverseVariance:
    """Least variance by the empirical variances, whatever the two estimates' distance.

    It is fooled where the first order is biased and its variance small (pathologies, sec. IV-C).
    """

    name: ClassVar[str] = "alpha-variance"
    summary: ClassVar[str] = "both orders, weighted by inverse empirical variance"

    def choose(self, seen: Evidence) -> Choice:
        """Choose ``alpha*``."""
        return Choice(inverse_variance(seen.first_variance, seen.zeroth_variance), "least variance")


@dataclass(frozen=True)
class FixedWeight:
    """A constant alpha in [0, 1]; raises :class:`~ocp.errors.InputError` outside."""

    alpha: Annotated[float, "weight of the first order"] = 0.5
    name: ClassVar[str] = "alpha-fixed"
    summary: ClassVar[str] = "both orders, with a constant weight"

    def __post_init__(self) -> None:
        if not 0 <= self.alpha <= 1:
            raise InputError(f"alpha-fixed: alpha must lie in [0, 1], got {self.alpha}")

    def choose(self, seen: Evidence) -> Choice:
        """Choose the constant."""
        return Choice(self.alpha, "constant")


Rule = ConfidenceTest | InverseVariance | FixedWeight
RULES: dict[str, type[Rule]] = {
    rule.name: rule for rule in (ConfidenceTest, InverseVariance, FixedWeight)
}
