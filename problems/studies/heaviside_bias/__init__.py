"""P2: the Heaviside function, whose pathwise gradient says nothing."""

from __future__ import annotations

from problems.spec import Citation
from problems.studies.study import Parts, Study


def _parts() -> Parts:
    from problems.studies.heaviside_bias.claims import claims
    from problems.studies.heaviside_bias.data import Params, run

    return Params, run, claims


study = Study(
    id="P2",
    title="Gradient estimates of the Heaviside function",
    citation=Citation("suh2022pathologies", "Fig. 2, example III.2"),
    parts=_parts,
    notes=(
        "erf(y; s²) in the paper is the upper tail of the Gaussian, not the usual error function.",
        "The mean of the first order's samples does converge, to 0: what fails in ex. III.2 is to"
        " exchange gradient and expectation.",
        "Zero-noise baseline as in the paper's definition, and the mean of the other samples.",
    ),
)
