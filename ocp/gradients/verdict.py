"""What an estimate is worth beside the gradient that is known: in words."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from dynamics.batch import Moments
from ocp.gradients.empirical_bias import EmpiricalBias, Jump
from ocp.gradients.reference import ReferenceGradient

Word = Literal[
    "unbiased within the interval",
    "biased",
    "empirically biased at this sample size",
    "no reference",
]
WIDE = "too wide to tell"
"""Said of an estimate within its interval where that is wider than the gradient itself."""
WORST_FIRST = (
    "biased",
    "empirically biased at this sample size",
    WIDE,
    "no reference",
    "unbiased within the interval",
)
"""What is said of estimates, from the weakest on."""
NEGLIGIBLE = 1e-4
"""Errors below this share of the gradient's largest component are no bias worth the name."""
CONFIDENCE = 0.999
"""Probability with which an unbiased estimate is called so, all components together."""


@dataclass(frozen=True)
class Verdict:
    """The word, the sentence that explains it, and the error's norm.

    ``largest_z`` is the largest error in standard errors, ``wide`` whether the interval is wider
    than the gradient itself, so that being within it says little.
    """

    word: Word
    sentence: str
    error: float
    largest_z: float
    wide: bool = False


def quantile(d: int) -> float:
    """Half-width, in standard errors, of ``d`` intervals that hold together with `CONFIDENCE`."""
    from scipy.stats import norm

    return float(norm.ppf(1 - (1 - CONFIDENCE) / (2 * d)))


def judge(
    moments: Moments,
    known: ReferenceGradient | None,
    jump: Jump | None = None,
    bias: EmpiricalBias | None = None,
) -> Verdict:
    """Judge an estimate's moments against ``known``, whose own error widens the interval.

    Outside the interval it is *biased* where the cost jumps, or where no jump was looked for: more
    samples will not mend it. It is *empirically biased at this sample size* where the cost is
    continuous, so that the expectation is right (pathologies, lemma III.1) and only samples that
    matter are too rare to have been seen.
    """
    if known is None:
        return Verdict("no reference", "There is no reference gradient.", np.nan, np.nan)
    off = moments.mean - known.gradient
    width = np.hypot(moments.standard_error, known.standard_error)
    # Rounding is told by size where there is one: a gradient of 1e-80 is not nothing.
    slack = NEGLIGIBLE * np.abs(known.gradient).max(initial=0) or 1e-15
    z = np.where(np.abs(off) <= slack, 0.0, np.abs(off) / np.maximum(width, 1e-300))
    error, worst, limit = float(np.linalg.norm(off)), float(z.max()), quantile(len(off))
    size = float(np.linalg.norm(known.gradient))
    told = f"off the {known.source} by {error:.3g} of {size:.3g}"
    if worst <= limit:
        wide = limit * float(np.linalg.norm(width)) > size
        tail = "; the interval is wider than the gradient itself, so more samples are needed"
        return Verdict(
            "unbiased within the interval",
            f"{told}, {worst:.2g} standard errors at most (allowed {limit:.3g}){tail * wide}.",
            error, worst, wide,
        )  # fmt: skip
    far = f"{told}, " + ("although the samples do not vary" if worst > 1e6 else
                         f"{worst:.3g} standard errors (allowed {limit:.3g})")  # fmt: skip
    if jump is not None and not jump.discontinuous:
        sentence = f"{far}; the cost is continuous, its steepest slope {jump.slope:.3g}"
        if bias is not None and bias.Delta > 0:
            sentence += (
                f", and a share {1 - bias.beta:.4g} of the samples lies within {bias.S:.2g} of a"
                f" mean that is {bias.Delta:.3g} off"
            )
        return Verdict("empirically biased at this sample size", f"{sentence}.", error, worst)
    why = f"; the cost jumps by {jump.size:.3g}" if jump is not None else ""
    return Verdict("biased", f"{far}{why}.", error, worst)


def short_verdict(row: Mapping[str, Any]) -> str:
    """What a stored estimate's verdict comes to: an interval too wide says nothing of bias."""
    return WIDE if row["wide"] else str(row["verdict"])


def weakest_verdict(rows: Iterable[Mapping[str, Any]]) -> str:
    """The weakest of what stored estimates come to."""
    return min((short_verdict(row) for row in rows), key=WORST_FIRST.index)
