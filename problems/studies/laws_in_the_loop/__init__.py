"""C1: costs of closed loops that plan again at every sample, compared between contact laws."""

from problems.studies.laws_in_the_loop.claims import claims
from problems.studies.laws_in_the_loop.data import QUICK, Params, run

NOTES = (
    "Every controller plans again at each sample by one quadratic program, which the last plan"
    " starts: phase qpcc under the exact law, relaxed under a smoothed one. Gains and inputs are"
    " of one plan, made before the first sample: gains of the linear-quadratic regulator"
    " along it, its contacts held where it is exact. Phase full is left out for its time.",
    "EWDA and networks are not among them: a learned law has no pairs of impulse and gap, and"
    " neither phase can plan under it.",
    "A cost is that of the problem over two horizons, its terminal cost included; for gains and"
    " inputs over the first, since their plan ends there; that favours them, for planning again"
    " looks beyond its end. It is told over the best controller's"
    " on the same task, plant and seed, and counts as a thousand times that at most.",
    "Seeds are starts around the problem's own, and on the plant noise also noise of 1 % of the"
    " characteristic sizes, of measurement and input. Mismatch makes one parameter of the plant"
    " 30 % larger: a mass, or the stiffness of soft-walls. Referee is left out where contact is as"
    " sharp in the model, and h/4 where the step size is part of the model.",
    "A run survives where it costs at most twice what the best controller costs from the same"
    " start on the model itself.",
    "In short, at the defaults: the exact law or a barrier of mu = 0.001, which survive alike. The"
    " exact law costs less on push-disc, the barrier on finger-disc and spinner at h/4. Trust no"
    " gentler barrier, and nothing on cart-walls at h/4, where no run survives.",
    "The nominal angle of spinner runs on from the start. If it began at the present angle at every"
    " sample, a loop that never turns the disc would cost the least.",
)
RESUMES = True

__all__ = ["NOTES", "QUICK", "Params", "claims", "run"]
