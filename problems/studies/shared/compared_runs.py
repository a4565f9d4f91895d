"""Whether one way of learning does better than another, from runs of several seeds each."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

RESAMPLES = 4000
"""How often the runs are drawn again."""


@dataclass(frozen=True)
class Difference:
    """Mean of one over that of the other, and the interval that holds it with 95 %."""

    mean: float
    low: float
    high: float

    @property
    def better(self) -> bool:
        """Whether zero lies below the interval."""
        return self.low > 0

    @property
    def margin(self) -> float:
        """The mean in standard errors, of which a normal interval of 95 % holds 3.92."""
        width = self.high - self.low
        return self.mean / (width / 3.92) if width > 0 else float(np.copysign(np.inf, self.mean))

    def __str__(self) -> str:
        return f"{self.mean:+.3g} ({self.low:+.3g} to {self.high:+.3g})"


def difference(one: np.ndarray, other: np.ndarray, paired: bool = True) -> Difference:
    """``mean(one) - mean(other)`` of runs (n,) with its percentile bootstrap.

    ``paired`` runs have seeds and starts in common and are drawn again together. Drawn out of seed
    0, so that the same runs give the same interval.
    """
    rng = np.random.default_rng(0)
    chosen = rng.integers(len(one), size=(RESAMPLES, len(one)))
    others = chosen if paired else rng.integers(len(other), size=(RESAMPLES, len(other)))
    drawn = one[chosen].mean(axis=1) - other[others].mean(axis=1)
    low, high = np.quantile(drawn, [0.025, 0.975])
    return Difference(float(one.mean() - other.mean()), float(low), float(high))


def least(gains: Iterable[Difference]) -> float:
    """The margin of the sentence that all of ``gains`` are gains."""
    return min(gain.margin for gain in gains)


def area(curve: np.ndarray) -> np.ndarray:
    """Mean height of curves (..., iterations): the area under them over their length."""
    return (curve[..., 1:] + curve[..., :-1]).mean(axis=-1) / 2
