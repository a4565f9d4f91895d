"""AT: plain gradient ascent on the throw of a ball beside the bound on its slowest step."""

from problems.spec import Citation
from problems.studies.study import Study

study = Study(
    id="AT",
    title="Convergence of policy gradients, beside its bound",
    citation=Citation("zhang2023adaptive", "Thm. 4.2, on the example of fig. 7a"),
    folder=__name__,
    notes=(
        "J is the mean exact return of the throw under the policy's noise; its gradient, and its"
        " Lipschitz constant L on the window the iterates stay in, come from a fine grid of returns"
        " folded with the noise's density, independent of any estimator.",
        "c = 1/(eta - L eta²) needs eta < 1/L; the theorem's index slips (errata, 27) are mended:"
        " the sum of gains telescopes over all steps taken.",
        "delta is the largest |theta| among the iterates.",
    ),
    quick={"runs": 2, "iterations": 20, "measured": 2000},
)
