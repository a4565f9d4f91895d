"""A2: a bouncing ball, by the softened equation of motion and by time stepping."""

from problems.spec import Citation
from problems.studies.study import Study

study = Study(
    id="A2",
    title="A bouncing ball: elastic as an equation, plastic by time stepping",
    citation=Citation("zhang2023adaptive", "Fig. 2 and C.1"),
    folder=__name__,
    notes=(
        "mu is that of the force, gamma y = mu; the impulse of one step has h mu. Its values are"
        " our choice, within what C.1 can be integrated at: least height is about exp(-g q0/mu).",
        "The equation conserves energy, so the softened ball bounces back to its height, whatever"
        " mu; the complementarity system of the paper is plastic. Neither is the other's limit:"
        " mu to 0 at fixed h rests on the floor, h to 0 at fixed mu bounces.",
    ),
)
