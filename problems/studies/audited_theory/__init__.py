"""T1: the papers' theorems on stiffness, variance and bias, tested on random contact problems."""

from problems.studies.audited_theory.claims import claims
from problems.studies.audited_theory.data import QUICK, Params, run

NOTES = (
    "Systems: C = D = I, A = B = E = 0, where the bounds are tightest; z standard normal,"
    " mu log-uniform from 1e-8 to 1; F symmetric positive definite, or a P-matrix that is"
    " neither symmetric nor definite. All numbers are without units.",
    "Thm. 4.5 puts a lower bound on l inside an upper bound on the slope, which bounds"
    " nothing; taken as an equality, it is the printed formula, and its sign (A.32) is wrong.",
    "dlam/dz = -(I - D + D F)^-1 D with D in [0, 1]: for a P-matrix the slope is bounded"
    " whatever mu. What grows as mu falls is the curvature, 1/(4 F^1.5 sqrt(mu)).",
)

__all__ = ["NOTES", "QUICK", "Params", "claims", "run"]
