"""Alpha-order batched gradient: first and zeroth order mixed by their variances, bias bounded."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from ocp.errors import InputError
from ocp.gradients.interpolation import bernstein, inverse_variance
from ocp.learning.experiment import Experiment, positive
from ocp.learning.protocol import Row, State
from ocp.learning.unrolls.unrolling import Unrolled, finite_samples, roll
from ocp.learning.unrolls.zopg import likelihood_ratio


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


def mixing(
    first: np.ndarray, zeroth: np.ndarray, gamma: float, delta: float
) -> tuple[float, float]:
    """Weight alpha of ``first`` (n, d) against ``zeroth`` (m, d), samples, and B = |g1 - g0|.

    ``alpha* = s0² / (s0² + s1²)``, the variances of both means, minimises the variance. The bias is
    at most gamma with probability 1 - delta where ``alpha B + eps <= gamma``, with the bound eps of
    the zeroth order's mean (:func:`~ocp.gradients.interpolation.bernstein`) by the largest
    deviation in the batch: alpha = alpha* where that holds, (gamma - eps) / B where not, and 0
    where eps > gamma.
    """
    (n, d), m = first.shape, len(zeroth)
    g1, g0 = first.mean(axis=0), zeroth.mean(axis=0)
    v1, v0 = (float(each.var(axis=0, ddof=1).sum()) for each in (first, zeroth))
    largest = float(np.linalg.norm(zeroth - g0, axis=1).max())
    eps = bernstein(m, d, v0, largest, delta)
    bias, best = float(np.linalg.norm(g1 - g0)), inverse_variance(v1 / n, v0 / m)
    if eps > gamma:
        return 0.0, bias
    return (best if best * bias <= gamma - eps else (gamma - eps) / bias), bias
