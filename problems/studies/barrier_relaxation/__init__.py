"""P6: implicit time stepping against its log-barrier relaxation, one step from the wall."""

from problems.spec import Citation
from problems.studies.study import Study

study = Study(
    id="P6",
    title="Implicit time stepping and its log-barrier relaxation",
    citation=Citation("suh2022pathologies", "Fig. 6, examples IV.1 and IV.2"),
    folder=__name__,
    notes=(
        "The barrier weight and the central-path parameter are one knob: mu = h/kappa for a gap in"
        " position, and lam is an impulse.",
        "The text calls kappa the weight of the barrier; the weight is 1/kappa.",
    ),
)
