"""A4: policies of hopper and half-cheetah, trained by seven algorithms and evaluated under the exact law."""

from problems.studies.trained_policies.claims import claims
from problems.studies.trained_policies.data import QUICK, RESUMES, Params, run

NOTES = (
    "All curves are returns of whole episodes of 5 s under the exact law, without noise on the"
    " actions, linear between evaluations.",
    "Every algorithm has its usual settings for the task, as ocp train has them, and learns"
    " until it has simulated the same number of steps. All steps count that are simulated to"
    " learn from, by whatever batch and under whatever law, until an episode ends; evaluations"
    " count for none.",
    "MBPO, whose updates take most of a second for a hundred steps, cannot spend that number"
    " here. It has an axis of its own, steps of its random exploration included, and no claim"
    " compares it at equal steps. Total propagation stands for the paper's PIPPS: it is that"
    " without a learned model and without importance weights. What else is not as published is"
    " in the tables of docs/theory/policies.md.",
    "AoBG has gamma = 1, its default. Where its batch is too small for that, alpha is 0, as its"
    " source has it, and it is a zeroth-order gradient that pays for an unused first order.",
    "Policies are affine in normalised observations; MBPO and the two networks named so"
    " have two tanh layers of 32. The paper tells neither horizon, batch, rate nor network.",
    "Plans are of the first second of an episode, 20 steps, by direct transcription under the"
    " exact law, from inputs that are held, and from where the best policy leads. A certified"
    " plan is a local optimum of its own; nothing is planned for after its end.",
    "From plans: a network fitted to them, and to their feedback beside them, is where FOPG"
    " begins; the other network begins by chance.",
    "Wall time is that of this machine, one process a run, and depends on what else it does.",
)

__all__ = ["NOTES", "QUICK", "RESUMES", "Params", "claims", "run"]
