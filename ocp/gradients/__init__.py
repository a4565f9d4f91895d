"""Sampled gradients of smoothed objectives: estimators, moments of their samples, and verdicts on bias."""

from ocp.gradients.estimation import Estimate, Sampling, estimate_gradient
from ocp.gradients.objective import SampledObjective, StaticObjective
from ocp.gradients.rollouts import RolloutObjective

__all__ = [
    "Estimate",
    "RolloutObjective",
    "SampledObjective",
    "Sampling",
    "StaticObjective",
    "estimate_gradient",
]
