"""A gradient estimator: zeroth order, with first order as its control variate."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from dynamics.batch import Gaussian
from ocp.gradients.estimators import Estimator, Sampler
from ocp.gradients.objective import SampledObjective


@dataclass(frozen=True)
class ControlVariate(Estimator):
    """Likelihood ratio of what a linear model of the cost leaves, where noise is on the decision.

    One sample is ``(V(theta + w) - V(theta) - g'w) w/sigma² + g``. Since ``E[g'w w]/sigma² = g`` it
    is unbiased for every g that does not depend on w, a biased one too; here g is the mean of
    ``slopes`` gradients at samples of their own. What is left of the variance is the curvature's.
    """

    slopes: int = 256
    name: str = "control-variate"
    summary: str = "zeroth order, less a linear model by first order"
    stream: ClassVar[int] = 5

    def make_sampler(self, objective: SampledObjective, noise: Gaussian, n: int) -> Sampler:
        """Find g from samples after the n that are estimated from."""
        variance = noise.component_scales(objective.n_noise) ** 2
        g = objective.sample_gradients(noise.skip_samples(n), self.slopes).direction.mean(axis=0)
        nominal_cost = objective.nominal_cost()

        def single(noise_part: Gaussian, m: int) -> np.ndarray:
            samples = objective.sample_scores(noise_part, m)
            residual = samples.cost - nominal_cost - samples.direction * variance @ g
            return residual[:, None] * samples.direction + g

        return Sampler(single)
