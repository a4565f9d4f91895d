"""Gradients of smoothed objectives from samples: estimators, their moments, and verdicts."""

from ocp.gradients.estimation import Estimate, Plan, estimate_gradient
from ocp.gradients.objective import SampledObjective, StaticObjective
from ocp.gradients.rollout_objective import RolloutObjective

__all__ = [
    "Estimate",
    "Plan",
    "RolloutObjective",
    "SampledObjective",
    "StaticObjective",
    "estimate_gradient",
]
