"""P7: gradients interpolated between the orders, where the first one is wrong or looks right."""

from problems.spec import Citation
from problems.studies.study import Study

study = Study(
    id="P7",
    title="Interpolated gradients: fooled, and not",
    citation=Citation("suh2022pathologies", "Sec. IV-C, eq. 6, on examples III.2, III.5, III.6"),
    folder=__name__,
    notes=(
        "alpha is the weight of the first order here; eq. 6 of the paper has it the other way.",
        "The bound on a single sample's deviation is the largest that the samples show.",
        "The zeroth order has the mean of the other samples as baseline, on its own noise.",
    ),
)
