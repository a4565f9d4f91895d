"""N3: smoothed and learned contact laws compared by the cost of their plans under the exact law."""

from problems.studies.smoothings_compared.claims import claims
from problems.studies.smoothings_compared.data import QUICK, Params, run

NOTES = (
    "In short, at the defaults: plan under the exact law by its default route, or under a sharp"
    " barrier or the adaptive law where few contacts act; trust no gentle barrier and no"
    " randomized plan unreplayed. A learned law is for where no other is known, over several"
    " seeds, and its word on its own plan is worth nothing: only the replay tells. Trust brings"
    " most replays nearer to their plans; only on push-1d does it make them cheaper.",
    "Every plan is made by direct transcription from the problem's own guess, which is without"
    " contact, and its inputs are replayed under the exact law. An excess is that replay's cost"
    " over the optimum of the exact law by its default route.",
    "Learned laws see transitions drawn in the problem's own region, half of them near the line"
    " from start to goal; widths are in units of the data's standard deviations. The networks"
    " are trained for seconds, not minutes: what is shown is what a quick model is worth.",
    "Trust is solved from the plan without it, to stay near the same local minimum. Its"
    " weight beta is told as a share of what a step costs at rest.",
    "On planar-push and planar-hand the law, exact or not, has the published gaps, linearised"
    " at every step, and the referee the true ones: no plan survives that, the exact law's own"
    " included; what a law is worth there is its replay under the exact law.",
    "Seconds are of the processor, of all its cores together.",
)
RESUMES = True

__all__ = ["NOTES", "QUICK", "Params", "claims", "run"]
