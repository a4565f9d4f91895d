"""P4: a ball against a rectangular wall, whose corner is a jump, and against a dome on it."""

from problems.spec import Citation
from problems.studies.study import Study

study = Study(
    id="P4",
    title="A ball against the corner of a wall, and against a dome",
    citation=Citation("suh2022pathologies", "Fig. 4 and example III.6"),
    folder=__name__,
    notes=(
        "Impacts are elastic mirror reflections inside a step; the authors' 0.9 of restitution is"
        " declared there, not used. The ground, at y = -0.1 m, is out of reach within the flight.",
        "The dome sits on the wall, its diameter the wall's width.",
    ),
)
