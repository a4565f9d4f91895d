"""N0: theory of learning from noised data, checked with weighted averages and networks."""

from problems.studies.theory_of_noising.claims import claims
from problems.studies.theory_of_noising.data import QUICK, Params, run

NOTES = (
    "sigma is in metres along a line, and in deviations of the data in many dimensions.",
    "For f(x) = x a rollout of g_sigma is the mean-shift iteration: it climbs the density of the noised data.",
    "Networks are trained on a fixed set of noised pairs, so that their number is known; with"
    " fresh noise in every minibatch it grows with the time of training.",
    "Neighbours: (sum w)²/sum w², of which both sums are densities, one of the width sigma/sqrt(2).",
)

__all__ = ["NOTES", "QUICK", "Params", "claims", "run"]
