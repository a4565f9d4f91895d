"""Gradients of smoothed objectives from samples: estimators, their moments, and verdicts."""

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
