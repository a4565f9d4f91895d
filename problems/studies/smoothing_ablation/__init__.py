"""A5: first-order policy gradients on the half-cheetah through contact of different mu."""

from problems.spec import Citation
from problems.studies.study import Study

study = Study(
    id="A5",
    title="Which mu to learn through: the half-cheetah",
    citation=Citation("zhang2023adaptive", "Fig. 5, sec. 7.4"),
    folder=__name__,
    notes=(
        "All curves are returns of whole episodes of 5 s under the exact law, without noise on the"
        " actions; the paper's axis tells neither law nor noise.",
        "FOPG as ocp train has it for the task, with the plain mean of gradients of eq. 4.2.",
    ),
    resumes=True,
    quick={"runs": 2, "iterations": 30, "judged": 5},
)
