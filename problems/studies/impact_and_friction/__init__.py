"""A6: derivatives of an impact and of friction under barrier, adaptive and randomized smoothing."""

from problems.studies.impact_and_friction.claims import claims
from problems.studies.impact_and_friction.data import Params, run

NOTES = (
    "RS averages the derivative that exists almost everywhere, as automatic differentiation"
    " gives it; only a sample inside the one step of the impact sees the jump.",
    "The box is problem box-slide: m (v+ - v) = h u + f, |f| <= b = friction h m g by maximal"
    " dissipation, in two pairs; the paper gives no equations.",
    "Costs are counted in solves, at the noise whose bias is the barrier's: an exact solve and"
    " one of the barrier's path take about as long here.",
    "The noise levels and every mu are our choice.",
)

__all__ = ["NOTES", "Params", "claims", "run"]
