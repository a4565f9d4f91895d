"""AM: one-step errors of a hopper with learned parameters psi, and of a network, over the number of transitions."""

from problems.studies.model_learning.claims import claims
from problems.studies.model_learning.data import QUICK, RESUMES, Params, run

NOTES = (
    "The paper names no parameters, ranges or sizes: here four masses, four inertias, friction,"
    " spring and damping of the joints start at random between half and twice the truth.",
    "The model's class holds the truth where data are exact; so each figure stands beside"
    " transitions with noise, and beside a hopper with a drag that the model does not know.",
    "Errors are means over held-out transitions of |x' - f(x, u)|, which adds m, rad, m/s and"
    " rad/s as the paper's does; the search weighs each coordinate by how much it moves.",
    "Intervals: 95 % of the minima of resampled transitions, out to what was found.",
)

__all__ = ["NOTES", "QUICK", "RESUMES", "Params", "claims", "run"]
