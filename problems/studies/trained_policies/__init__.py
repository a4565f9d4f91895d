"""A4: policies for machines trained by seven algorithms, judged under the exact law."""

from problems.spec import Citation
from problems.studies.study import Study

study = Study(
    id="A4",
    title="Seven ways to train a policy, judged under exact contact",
    citation=Citation("zhang2023adaptive", "Fig. 4, sec. 7.3"),
    folder=__name__,
    notes=(
        "All curves are returns of whole episodes of 5 s under the exact law, without noise on the"
        " actions; what is drawn at a number of steps is the last judgement before it.",
        "Every algorithm has its usual settings for the task, as ocp train has them, and as many"
        " simulated steps; PIPPS and MBPO, whose steps cost the most, a part of them.",
        "Policies are affine in normalised observations. The paper tells neither horizon, batch,"
        " rate nor network.",
        "Plans are of the first second of an episode, 20 steps, by direct transcription under the"
        " exact law, from inputs that are held, and from where the best policy leads. A certified"
        " plan is a local optimum of its own; nothing is planned for after its end.",
        "From plans: a network fitted to them, and to their feedback beside them, is where FOPG"
        " begins; the other network begins by chance.",
        "Wall time is that of this machine, one process a run, and depends on what else it does.",
    ),
    resumes=True,
    quick={"runs": 2, "kilosteps": 40, "judged": 5, "plans": 1},
)
