"""A7: the throw of a ball learned by gradients of four kinds, on the landscapes they climb."""

from problems.spec import Citation
from problems.studies.study import Study

study = Study(
    id="A7",
    title="Throwing a ball: four policy gradients and their landscapes",
    citation=Citation("zhang2023adaptive", "Fig. 7a and sec. 7.3"),
    folder=__name__,
    notes=(
        "The paper gives no numbers: ball, floor and goal are those of the task ball-throw, whose"
        " goal is where 0.6 rad at 3 m/s leads, so that the best return is 0 but for the scheme.",
        "The decision is angle and speed; the paper turns the angle alone.",
        "Every curve is the return of the decision itself, without noise, under the exact law.",
        "All methods have as many samples, the same rate, the same starts and Adam.",
    ),
    quick={"runs": 3, "iterations": 60},
)
