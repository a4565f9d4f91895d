"""Verdicts on gradient estimates: comparison with a reference, search for jumps, and empirical bias."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from dynamics.batch import Gaussian, Moments
from ocp.errors import InputError
from ocp.gradients.objective import SampledObjective
from ocp.gradients.sampling import ReferenceGradient


@dataclass(frozen=True)
class EmpiricalBias:
    """Empirical bias (beta, Delta, S) of samples z (n, d), as in Suh, Simchowitz, Zhang et al. (2022), def. III.3.

    On an event of probability ``1 - beta`` the samples are within ``S`` of their conditional mean, which
    differs from the mean of z by ``Delta``. ``beta_upper`` is the 95 % upper bound on beta, given the fraction of
    the n samples outside the event. ``variance`` is the trace of the samples' covariance. It has two lower
    bounds: ``bound`` is ``max(0, (1 - beta) Delta - beta |E z|)^2 / beta`` (lemma III.4), and ``sharp`` is the
    tighter ``(1 - beta)/beta Delta^2``, which does not change if z is shifted. Both use ``beta_upper`` if no
    sample is outside the event.
    """

    beta: float
    beta_upper: float
    Delta: float
    S: float
    variance: float
    bound: float
    sharp: float


def empirical_bias(samples: np.ndarray, mean: np.ndarray | None = None) -> EmpiricalBias:
    """Return the empirical bias that explains the most variance of ``samples`` (n, d).

    Events are balls around the componentwise median. The ball with the largest bound ``(1 - beta)/beta Delta^2`` is
    chosen; it may contain all samples. ``mean`` (d,) is the known expectation E z (default: the samples' mean).

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
    counts = np.arange(1, n + 1)
    inside = np.cumsum(z, axis=0) / counts[:, None]
    distance = np.linalg.norm(inside - centre, axis=1)
    # A ball includes all samples at its radius; events of probability below a half are not informative.
    complete_ball = np.append(radius[1:] > radius[:-1], True) & (2 * counts > n)
    beta = 1 - counts / n
    weight = np.divide(counts, n - counts, out=np.full(n, float(n)), where=counts < n)
    widest = int(np.argmax(np.where(complete_ball, weight * distance**2, -1.0)))
    b, Delta, middle = float(beta[widest]), float(distance[widest]), inside[widest]
    upper = _probability_bound(n - int(counts[widest]), n)
    share = b if b > 0 else upper
    shift = max(0.0, (1 - share) * Delta - share * float(np.linalg.norm(centre)))
    return EmpiricalBias(
        beta=b,
        beta_upper=upper,
        Delta=Delta,
        S=float(np.linalg.norm(z[: widest + 1] - middle, axis=1).max()),
        variance=float(np.square(z - z.mean(axis=0)).sum(axis=1).mean()),
        bound=shift**2 / share,
        sharp=(1 - share) / share * Delta**2,
    )


def _probability_bound(outside: int, n: int) -> float:
    """Return the 95 % Clopper-Pearson upper bound on the probability of an event observed ``outside`` times in n."""
    from scipy.stats import binomtest

    return float(binomtest(outside, n, alternative="less").proportion_ci(0.95).high)


@dataclass(frozen=True)
class Jump:
    """Sharpest change of a cost between samples: change by ``size`` over the distance ``width``.

    ``discontinuous`` is true if the change remained while the distance was halved down to rounding errors.
    ``noise`` is the noise vector (n_noise,) at which the cost changes.
    """

    size: float
    width: float
    discontinuous: bool
    noise: np.ndarray = field(default_factory=lambda: np.zeros(0))

    @property
    def slope(self) -> float:
        """Mean slope of the cost over the width, infinite for width 0."""
        return self.size / self.width if self.width > 0 else np.inf


_JUMP_LINES = 64
"""Number of lines along which a discontinuity is searched for."""
_LINE_SEGMENTS = 64
"""Number of segments into which each line is divided."""
_SEGMENT_HALVINGS = 42
"""Number of halvings of the segment with the largest change, enough to reach rounding error."""
_LINE_CANDIDATES = 1 << 14
"""Number of samples from which the ends of the lines are chosen."""


def find_sharpest_change(objective: SampledObjective, noise: Gaussian) -> Jump:
    """Search for a discontinuity of the cost along lines between samples.

    Lines go from zero noise to 64 samples and are divided into 64 segments. On each line the segment with the
    largest change of the cost is halved repeatedly, each time keeping the half with the larger change. If the
    cost is continuous, however steep, its change tends to zero; at a discontinuity it does not. The 64 samples are
    those with the largest residuals of a linear fit of the cost among 16384, so that jumps that few samples cross
    are found.
    """
    noise_samples = noise.draw(_LINE_CANDIDATES, 1, objective.n_noise)[:, 0]
    end = noise_samples[_least_linear(noise_samples, objective.costs(noise_samples))]
    return sharpest_change_on_lines(objective, np.zeros_like(end), end)


def sharpest_change_on_lines(objective: SampledObjective, start: np.ndarray, end: np.ndarray) -> Jump:
    """Search for a discontinuity of the cost on the lines from the noise ``start`` to ``end``, both (lines, n_noise).

    ``place`` of the result is the noise at the sharpest change.
    """
    share = np.linspace(0, 1, _LINE_SEGMENTS + 1)[None, :, None]
    grid = start[:, None] * (1 - share) + end[:, None] * share
    cost = objective.costs(grid.reshape(-1, objective.n_noise)).reshape(len(start), -1)
    changes = np.nan_to_num(np.abs(np.diff(cost, axis=1)))
    segment, line = changes.argmax(axis=1), np.arange(len(start))
    lower_end, upper_end = grid[line, segment], grid[line, segment + 1]
    values = [cost[line, segment], cost[line, segment + 1]]
    initial_change = np.abs(values[1] - values[0])
    for _ in range(_SEGMENT_HALVINGS):
        middle = (lower_end + upper_end) / 2
        middle_cost = objective.costs(middle)
        lower = (np.abs(middle_cost - values[0]) >= np.abs(values[1] - middle_cost))[:, None]
        lower_end, upper_end = np.where(lower, lower_end, middle), np.where(lower, middle, upper_end)
        values = [np.where(lower[:, 0], values[0], middle_cost), np.where(lower[:, 0], middle_cost, values[1])]
    final_change, spread = np.abs(values[1] - values[0]), float(np.ptp(cost[np.isfinite(cost)]))
    jumps = (final_change > 0.5 * initial_change) & (final_change > 1e-6 * spread)
    sharpest = int(np.argmax(np.where(jumps, final_change, -1.0) if jumps.any() else initial_change))
    if jumps.any():
        width = float(np.linalg.norm(upper_end[sharpest] - lower_end[sharpest]))
        return Jump(float(final_change[sharpest]), width, True, lower_end[sharpest])
    width = float(np.linalg.norm((end - start)[sharpest])) / _LINE_SEGMENTS
    return Jump(float(initial_change[sharpest]), width, False, lower_end[sharpest])


def _least_linear(noise: np.ndarray, cost: np.ndarray) -> np.ndarray:
    """Return the indices of the samples with the largest residuals of a linear fit of the cost to the noise."""
    finite = np.isfinite(cost)
    columns = np.column_stack([np.ones(len(noise)), noise])
    fit = np.linalg.lstsq(columns[finite], cost[finite], rcond=None)[0]
    residual = np.where(finite, np.abs(cost - columns @ fit), -1.0)
    return np.argsort(-residual, kind="stable")[:_JUMP_LINES]


Word = Literal[
    "unbiased within the interval",
    "biased",
    "empirically biased at this sample size",
    "no reference",
]
TOO_WIDE = "too wide to tell"
"""Short verdict on an estimate whose confidence interval is wider than the gradient."""
WORST_FIRST = (
    "biased",
    "empirically biased at this sample size",
    TOO_WIDE,
    "no reference",
    "unbiased within the interval",
)
"""Short verdicts in order, from the worst to the best."""
NEGLIGIBLE = 1e-4
"""Maximum error of a component that does not count as bias, as a fraction of the gradient's largest component."""
CONFIDENCE = 0.999
"""Probability that an unbiased estimate is judged unbiased in all components together."""


@dataclass(frozen=True)
class Verdict:
    """Verdict ``word`` on a gradient estimate, with an explaining ``sentence`` and the norm ``error`` of the error.

    ``largest_z`` is the largest component of the error, in standard errors. ``wide`` is true if the confidence
    interval is wider than the gradient, so that the verdict is not informative.
    """

    word: Word
    sentence: str
    error: float
    largest_z: float
    wide: bool = False


def joint_quantile(d: int) -> float:
    """Return the half-width, in standard errors, of ``d`` intervals with joint probability ``CONFIDENCE``."""
    from scipy.stats import norm

    return float(norm.ppf(1 - (1 - CONFIDENCE) / (2 * d)))


def judge_estimate(
    moments: Moments,
    reference: ReferenceGradient | None,
    jump: Jump | None = None,
    bias: EmpiricalBias | None = None,
) -> Verdict:
    """Judge an estimate by its ``moments``, compared with ``reference``, whose error widens the interval.

    An estimate whose interval does not contain the reference is *biased* if the cost jumps, or if ``jump`` is
    None; more samples will not help. It is *empirically biased at this sample size* if the cost is continuous:
    then its expectation is correct (Suh, Simchowitz, Zhang et al. 2022, lemma III.1), but the samples that
    determine it are so rare that none was drawn.
    """
    if reference is None:
        return Verdict("no reference", "There is no reference gradient.", np.nan, np.nan)
    error_vector = moments.mean - reference.gradient
    width = np.hypot(moments.standard_error, reference.standard_error)
    # The tolerance is relative to the gradient, even for a gradient of 1e-80, unless the gradient is zero.
    slack = NEGLIGIBLE * np.abs(reference.gradient).max(initial=0) or 1e-15
    z = np.where(np.abs(error_vector) <= slack, 0.0, np.abs(error_vector) / np.maximum(width, 1e-300))
    error, worst, limit = float(np.linalg.norm(error_vector)), float(z.max()), joint_quantile(len(error_vector))
    size = float(np.linalg.norm(reference.gradient))
    deviation = f"off the {reference.source} by {error:.3g} of {size:.3g}"
    if worst <= limit:
        wide = limit * float(np.linalg.norm(width)) > size
        wide_note = "; the interval is wider than the gradient itself, so more samples are needed"
        return Verdict(
            "unbiased within the interval",
            f"{deviation}, {worst:.2g} standard errors at most (allowed {limit:.3g}){wide_note * wide}.",
            error,
            worst,
            wide,
        )
    excess = f"{deviation}, " + (
        "although the samples do not vary" if worst > 1e6 else f"{worst:.3g} standard errors (allowed {limit:.3g})"
    )
    if jump is not None and not jump.discontinuous:
        sentence = f"{excess}; the cost is continuous, its steepest slope {jump.slope:.3g}"
        if bias is not None and bias.Delta > 0:
            sentence += (
                f", and a share {1 - bias.beta:.4g} of the samples lies within {bias.S:.2g} of a"
                f" mean that is {bias.Delta:.3g} off"
            )
        return Verdict("empirically biased at this sample size", f"{sentence}.", error, worst)
    jump_note = f"; the cost jumps by {jump.size:.3g}" if jump is not None else ""
    return Verdict("biased", f"{excess}{jump_note}.", error, worst)


def short_verdict(row: Mapping[str, Any]) -> str:
    """Return the verdict of a stored estimate, or :data:`TOO_WIDE` if its interval is too wide."""
    return TOO_WIDE if row["wide"] else str(row["verdict"])


def weakest_verdict(rows: Iterable[Mapping[str, Any]]) -> str:
    """Return the worst short verdict of stored estimates."""
    return min((short_verdict(row) for row in rows), key=WORST_FIRST.index)
