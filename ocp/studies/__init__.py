"""Studies: gradient estimation, and the store of their runs."""

from ocp.studies.estimation import Estimate, Plan, estimate_gradient
from ocp.studies.objective import SampledObjective, StaticObjective
from ocp.studies.rollout_objective import RolloutObjective

__all__ = [
    "Estimate",
    "Plan",
    "RolloutObjective",
    "SampledObjective",
    "StaticObjective",
    "estimate_gradient",
]
