"""AM: a hopper's next state by its physical parameters, learned, and by a network."""

from problems.spec import Citation
from problems.studies.study import Study

study = Study(
    id="AM",
    title="A hopper's next state from few transitions",
    citation=Citation("zhang2023adaptive", "Sec. 7, model learning, and eq. 4.1"),
    folder=__name__,
    notes=(
        "The paper names no parameters, ranges or sizes: here four masses, four inertias, friction,"
        " spring and damping of the joints start at random between half and twice the truth.",
        "The model's class holds the truth where data are exact; so each figure stands beside"
        " transitions with noise, and beside a hopper with a drag that the model does not know.",
        "Errors are means over held-out transitions of |x' - f(x, u)|, which adds m, rad, m/s and"
        " rad/s as the paper's does; the search weighs each coordinate by how much it moves.",
        "Intervals: 95 % of the minima of resampled transitions, out to what was found.",
    ),
    resumes=True,
    quick={"seeds": 1, "held": 300, "iterations": 100, "rows": 64, "units": 64, "epochs": 100},
)
