"""A2v: variance of first-order and likelihood-ratio gradients of a landing ball, over mu."""

from problems.spec import Citation
from problems.studies.study import Study

study = Study(
    id="A2v",
    title="Gradient variance of a landing ball over mu",
    citation=Citation("zhang2023adaptive", "Sec. 7.2, the figure beside the text"),
    folder=__name__,
    notes=(
        "Time stepping is plastic, so no chaos builds up over bounces: after the impact the ball"
        " forgets its height. Variance is largest where the rollout ends near the impact.",
        "mu is that of the impulse, in N s m; positions and velocities weigh one in SI units.",
    ),
)
