"""Estimators of the gradient of a smoothed objective: what one sample of each is."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from dynamics.batch import Gaussian, Moments
from ocp.errors import InputError
from ocp.gradients.objective import Bulk, SampledObjective

CHUNK = 1 << 13
"""Samples that are worked on at once; fixed, since sums are taken chunk by chunk."""

Contributions = Callable[[Gaussian, int], np.ndarray]
"""Maps (noise from its first sample on, m) to the estimates (m, d) of m single samples."""


class Sampler(NamedTuple):
    """``single`` estimates, and the moments of many at once by ``bulk``, None where it cannot."""

    single: Contributions
    bulk: Callable[[Gaussian, int], Bulk | None] = lambda noise, m: None


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
    def sampler(self, objective: SampledObjective, noise: Gaussian, n: int) -> Sampler:
        """Return what gives the single estimates; ``n`` is how many there will be."""


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
    stream: ClassVar[int] = 0

    def sampler(self, objective: SampledObjective, noise: Gaussian, n: int) -> Sampler:
        """Fix the baseline and return ``(V - b) s``; raises for ``mean`` of a single sample."""
        baseline, factor = 0.0, 1.0
        if self.baseline in ("zero-noise", "antithetic"):
            baseline = objective.nominal()
        elif self.baseline == "mean":
            if n < 2:
                raise InputError("the mean of the other samples needs 2 samples or more, got 1")
            # V_i less the mean of the others is n/(n-1) times V_i less the mean of all.
            baseline, factor = mean_cost(objective, noise, n), n / (n - 1)

        def one(g: Gaussian, m: int) -> np.ndarray:
            found = objective.scored(g, m)
            return (factor * (found.cost - baseline))[:, None] * found.direction

        def bulk(g: Gaussian, m: int) -> Bulk | None:
            found = objective.moments(g, m, "zeroth", baseline)
            if found is None:
                return None
            told, bad = found
            return Moments(told.n, factor * told.mean, factor**2 * told.m2), bad

        if self.baseline == "antithetic":
            return Sampler(lambda g, m: (one(g, m) + one(g.mirrored(), m)) / 2)
        return Sampler(one, bulk)


def mean_cost(objective: SampledObjective, noise: Gaussian, n: int) -> float:
    """Mean of the finite costs among n samples."""
    fused = objective.moments(noise, n, "cost")
    if fused is not None:
        return float(fused[0].mean[0])
    total, count = 0.0, 0
    for begin in range(0, n, CHUNK):
        cost = objective.scored(noise.after(begin), min(CHUNK, n - begin)).cost
        finite = cost[np.isfinite(cost)]
        total, count = total + float(finite.sum()), count + len(finite)
    return total / max(count, 1)


@dataclass(frozen=True)
class FirstOrder(Estimator):
    """FoBG, the pathwise gradient ``grad_theta V(theta, w)`` (pathologies, def. II.2)."""

    name: str = "fobg"
    summary: str = "first order, gradients through contact"
    stream: ClassVar[int] = 1

    def sampler(self, objective: SampledObjective, noise: Gaussian, n: int) -> Sampler:
        """Return the gradients; where the cost is not finite no gradient means anything."""

        def contributions(g: Gaussian, m: int) -> np.ndarray:
            found = objective.differentiated(g, m)
            return np.where(np.isfinite(found.cost)[:, None], found.direction, np.nan)

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

    def sampler(self, objective: SampledObjective, noise: Gaussian, n: int) -> Sampler:
        """Return the antithetic differences."""

        def contributions(g: Gaussian, m: int) -> np.ndarray:
            one, other = (objective.perturbed(side, m) for side in (g, g.mirrored()))
            return ((one.cost - other.cost) / 2)[:, None] * one.direction

        return Sampler(contributions)


_BASELINES = (
    ("zobg", "none", 1, "without baseline"),
    ("zobg-zero-noise", "zero-noise", 1, "the cost without noise as baseline"),
    ("zobg-mean", "mean", 2, "the mean cost of the other samples as baseline"),
    ("zobg-antithetic", "antithetic", 2, "pairs of samples at w and -w"),
)
"""Name, baseline, evaluations (a pair, or a pass more for the mean) and what it is."""
SAMPLED: dict[str, Estimator] = {
    estimator.name: estimator
    for estimator in (
        *(ZeroOrder(name, f"zeroth order, {what}", of, k) for name, of, k, what in _BASELINES),
        FirstOrder(),
        EvolutionStrategies(),
    )
}
"""Estimators that are means of independent samples, by name."""
