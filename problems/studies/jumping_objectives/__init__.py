"""P1: three simple systems, their smoothed objectives and estimated gradients."""

from problems.spec import Citation
from problems.studies.study import Study

study = Study(
    id="P1",
    title="Three simple systems with jumps",
    citation=Citation("suh2022pathologies", "Fig. 1 and sec. III-A"),
    folder=__name__,
    notes=(
        "All three are minimised: minus height, minus squared distance, minus squared angular"
        " velocity.",
        "The authors' code draws panel C from the surrogate -sin²(theta) up to 45 degrees; here the"
        " ball hits a bar, pivoted in its middle, in a plastic frictionless impact.",
    ),
)
