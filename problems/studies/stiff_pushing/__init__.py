"""P5: pushing through a stiff spring: gradient variance over stiffness, and where it ends."""

from problems.spec import Citation
from problems.studies.study import Study

study = Study(
    id="P5",
    title="Pushing through a stiff spring, and without one",
    citation=Citation("suh2022pathologies", "Fig. 5, example III.7 and sec. IV-A"),
    folder=__name__,
    notes=(
        "In the authors' code damping is the factor c on the velocity in each step, no dashpot;"
        " with the sweep's own c = 0.1 the curves do not cross. Drawn are the values of their task"
        " runs, with the running cost of fig. 5 alone.",
        "The stability limit follows from the relative motion: stiffness 2 k on mass m.",
        "Variances are traces of the covariance of one sample over all inputs.",
    ),
)
