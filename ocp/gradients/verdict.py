"""What an estimate is worth beside the known gradient, and whether it looks sure and is wrong."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from dynamics.batch import Gaussian, Moments
from ocp.errors import InputError
from ocp.gradients.objective import SampledObjective
from ocp.gradients.sampling import ReferenceGradient


@dataclass(frozen=True)
class EmpiricalBias:
    """A triple (beta, Delta, S) of pathologies, def. III.3, found in samples z of shape (n, d).

    On an event of probability ``1 - beta`` the samples lie within ``S`` of their mean there, which
    is ``Delta`` off the mean of z. ``beta_upper`` is the 95 % upper bound on beta when no more
    than a share beta of n samples was seen outside. ``variance`` is the trace of the samples'
    covariance, ``bound`` lemma III.4's, ``max(0, (1 - beta) Delta - beta |E z|)^2 / beta``, and
    ``sharp`` the tighter ``(1 - beta)/beta Delta^2``, which needs no ``|E z|`` and does not change
    when z is shifted; both take ``beta_upper`` where no sample was outside.
    """

    beta: float
    beta_upper: float
    Delta: float
    S: float
    variance: float
    bound: float
    sharp: float


def empirical_bias(samples: np.ndarray, mean: np.ndarray | None = None) -> EmpiricalBias:
    """Find the triple that explains the most variance of ``samples`` (n, d).

    Events are balls around the componentwise median. The one whose bound
    ``(1 - beta)/beta Delta^2`` is the largest is taken; it holds the whole sample where that is
    nearest to what is seen. ``mean`` (d,) is E z where known, by default the samples' own mean.

    Raises :class:`~ocp.errors.InputError` for fewer than two samples.
    """
    z = np.asarray(samples, dtype=float)
    z = z[:, None] if z.ndim == 1 else z
    n = len(z)
    if n < 2:
        raise InputError(f"an empirical bias needs 2 samples or more, got {n}")
    centre = z.mean(axis=0) if mean is None else np.asarray(mean, dtype=float).reshape(-1)
    radius = np.linalg.norm(z - np.median(z, axis=0), axis=1)
    order = np.argsort(radius, kind="stable")
    z, radius = z[order], radius[order]
    kept = np.arange(1, n + 1)
    inside = np.cumsum(z, axis=0) / kept[:, None]
    distance = np.linalg.norm(inside - centre, axis=1)
    # A ball holds all samples at its radius, and an event of probability below a half says little.
    whole = np.append(radius[1:] > radius[:-1], True) & (2 * kept > n)
    beta = 1 - kept / n
    weight = np.divide(kept, n - kept, out=np.full(n, float(n)), where=kept < n)
    best = int(np.argmax(np.where(whole, weight * distance**2, -1.0)))
    b, Delta, middle = float(beta[best]), float(distance[best]), inside[best]
    upper = _upper(n - int(kept[best]), n)
    share = b if b > 0 else upper
    shift = max(0.0, (1 - share) * Delta - share * float(np.linalg.norm(centre)))
    return EmpiricalBias(
        beta=b,
        beta_upper=upper,
        Delta=Delta,
        S=float(np.linalg.norm(z[: best + 1] - middle, axis=1).max()),
        variance=float(np.square(z - z.mean(axis=0)).sum(axis=1).mean()),
        bound=shift**2 / share,
        sharp=(1 - share) / share * Delta**2,
    )


def _upper(outside: int, n: int) -> float:
    """Clopper and Pearson's 95 % upper bound on a probability seen ``outside`` times in n."""
    from scipy.stats import binomtest

    return float(binomtest(outside, n, alternative="less").proportion_ci(0.95).high)


@dataclass(frozen=True)
class Jump:
    """The sharpest change of the cost found between samples: ``size`` over a distance ``width``.

    ``discontinuous`` where halving the distance to rounding left the change standing.
    """

    size: float
    width: float
    discontinuous: bool

    @property
    def slope(self) -> float:
        """Mean slope over the width."""
        return self.size / self.width if self.width > 0 else np.inf


_LINES, _PARTS, _HALVINGS, _TRIED = 64, 64, 42, 1 << 14


def sharpest_change(objective: SampledObjective, noise: Gaussian) -> Jump:
    """Look for a discontinuity of the cost along lines between samples.

    On lines from no noise to 64 samples, the part of 64 in which the cost changes most is halved
    again and again, keeping the half that changes more. A continuous cost, however steep, loses
    its change on the way; one that jumps keeps it. The samples are those of 16384 whose cost is
    the farthest from the best linear fit, so that a jump that few samples cross is found as well.
    """
    drawn = noise.draw(_TRIED, 1, objective.n_noise)[:, 0]
    end = drawn[_least_linear(drawn, objective.costs(drawn))]
    start = np.zeros_like(end)
    share = np.linspace(0, 1, _PARTS + 1)[None, :, None]
    grid = start[:, None] * (1 - share) + end[:, None] * share
    cost = objective.costs(grid.reshape(-1, objective.n_noise)).reshape(_LINES, -1)
    changes = np.nan_to_num(np.abs(np.diff(cost, axis=1)))
    part, line = changes.argmax(axis=1), np.arange(_LINES)
    left, right = grid[line, part], grid[line, part + 1]
    values = [cost[line, part], cost[line, part + 1]]
    first = np.abs(values[1] - values[0])
    for _ in range(_HALVINGS):
        middle = (left + right) / 2
        at = objective.costs(middle)
        lower = (np.abs(at - values[0]) >= np.abs(values[1] - at))[:, None]
        left, right = np.where(lower, left, middle), np.where(lower, middle, right)
        values = [np.where(lower[:, 0], values[0], at), np.where(lower[:, 0], at, values[1])]
    last, spread = np.abs(values[1] - values[0]), float(np.ptp(cost[np.isfinite(cost)]))
    jumps = (last > 0.5 * first) & (last > 1e-6 * spread)
    best = int(np.argmax(np.where(jumps, last, -1.0) if jumps.any() else first))
    if jumps.any():
        width = float(np.linalg.norm(right[best] - left[best]))
        return Jump(float(last[best]), width, discontinuous=True)
    width = float(np.linalg.norm((end - start)[best])) / _PARTS
    return Jump(float(first[best]), width, discontinuous=False)


def _least_linear(noise: np.ndarray, cost: np.ndarray) -> np.ndarray:
    """Indices of the samples whose cost a linear function of the noise explains the least."""
    finite = np.isfinite(cost)
    columns = np.column_stack([np.ones(len(noise)), noise])
    fit = np.linalg.lstsq(columns[finite], cost[finite], rcond=None)[0]
    residual = np.where(finite, np.abs(cost - columns @ fit), -1.0)
    return np.argsort(-residual, kind="stable")[:_LINES]


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
            error,
            worst,
            wide,
        )
    far = f"{told}, " + (
        "although the samples do not vary" if worst > 1e6 else f"{worst:.3g} standard errors (allowed {limit:.3g})"
    )
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
