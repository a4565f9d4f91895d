"""P2: the Heaviside function, whose pathwise gradient says nothing."""

from problems.spec import Citation
from problems.studies.study import Study

study = Study(
    id="P2",
    title="Gradient estimates of the Heaviside function",
    citation=Citation("suh2022pathologies", "Fig. 2, example III.2"),
    folder=__name__,
    notes=(
        "erf(y; s²) in the paper is the upper tail of the Gaussian, not the usual error function.",
        "The mean of the first order's samples does converge, to 0: what fails in ex. III.2 is to"
        " exchange gradient and expectation.",
        "Zero-noise baseline as in the paper's definition, and the mean of the other samples.",
    ),
)
