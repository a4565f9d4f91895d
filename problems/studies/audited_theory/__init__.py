"""T1: the papers' theorems on stiffness, variance and bias, against random contact problems."""

from problems.spec import Citation
from problems.studies.study import Study

study = Study(
    id="T1",
    title="The theory audited on random contact problems",
    citation=Citation(
        "zhang2023adaptive",
        "Thm. 4.4, 4.5, 5.1, 5.4, prop. 5.2, 5.3; and lemmas III.1, III.4 of Pathologies",
    ),
    folder=__name__,
    notes=(
        "Systems: C = D = I, A = B = E = 0, where the bounds are tightest; z standard normal,"
        " mu log-uniform from 1e-8 to 1; F symmetric positive definite, or a P-matrix that is"
        " neither symmetric nor definite. All numbers are without units.",
        "Thm. 4.5 puts a lower bound on l inside an upper bound on the slope, which bounds"
        " nothing; taken as an equality, it is the printed formula, and its sign (A.32) is wrong.",
        "dlam/dz = -(I - D + D F)^-1 D with D in [0, 1]: for a P-matrix the slope is bounded"
        " whatever mu. What grows as mu falls is the curvature, 1/(4 F^1.5 sqrt(mu)).",
    ),
)
