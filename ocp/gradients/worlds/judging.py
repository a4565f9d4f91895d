"""Verdict on the gradient of a simulator, from tests of its measurements, and advice on what to use instead."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from ocp.gradients.worlds.measures import FIRST_ORDER, Secants
from ocp.judge.findings import Finding, make_finding

ZERO_SHARE = 1e-9
"""Largest slope that counts as zero, as a share of the scale of slopes."""
DERIVATIVE_TOLERANCE = 1e-3
"""Largest relative difference between a derivative and a secant of the same output."""
FLAT_SHARE = 1e-3
"""Largest exact slope that counts as zero, as a share of the slopes over the largest amplitudes."""
NEARBY_SHARE = 0.9
"""Share of nearby points whose slope must be right."""
GROWTH = 1.4
"""Minimum factor by which an exploding slope grows at each refinement, or each time the horizon is extended."""
STEADY_RATE = 0.7
"""Smallest ratio of the rates at which an exponential grows over two extensions of the horizon; powers have 1/2."""
DECAY = 0.6
"""Maximum ratio of the error after two refinements to the error before, for an error that vanishes."""
AGREEING_AMPLITUDES = 3
"""Number of consecutive amplitudes whose secants must agree with the exact slope."""


@dataclass(frozen=True)
class Measures:
    """Measurements of one simulator, see :mod:`ocp.gradients.worlds.measures`.

    ``slope`` is the local slope at the nominal parameter, and ``nearby`` (n,) are the slopes at points around it.
    ``truth`` and ``nearby_truth`` (n,) are the exact slopes at the same points. ``jump`` is the size of a jump of the
    output within the largest amplitude, and the parameter at which it occurs. ``truth_secants`` are the secants of the
    exact output, or None if it is unknown; the simulator's own secants over the largest amplitude then serve as exact
    slopes. ``refinements`` and ``horizons`` are slopes of refined simulators, and of longer simulations.
    """

    slope: float
    nearby: np.ndarray
    truth: float
    nearby_truth: np.ndarray
    secants: Secants
    truth_secants: Secants | None
    has_gradient: bool
    jump: tuple[float, float] | None
    refinements: list[dict[str, Any]]
    horizons: list[dict[str, Any]]
    smoothed: list[dict[str, Any]]

    @cached_property
    def wide(self) -> np.ndarray:
        """Exact slopes over the largest amplitudes and noises; the first is that over the largest amplitude."""
        exact = self.secants if self.truth_secants is None else self.truth_secants
        smoothed = [row["reference"] for row in self.smoothed if row["reference"] is not None]
        return np.array([*exact.slopes[: -AGREEING_AMPLITUDES - 1 : -1], *smoothed, exact.ahead[-1], exact.behind[-1]])

    @property
    def sides(self) -> tuple[float, float]:
        """Smallest and largest exact slope at the nominal parameter, which differ at a kink."""
        exact, slopes = self.truth_secants, [self.truth]
        if exact is not None:
            slopes += [float(exact.ahead[exact.sharpest]), float(exact.behind[exact.sharpest])]
        return min(slopes), max(slopes)

    @property
    def is_flat(self) -> bool:
        """Whether the exact slope is zero compared with those in reach, as at an optimum."""
        return abs(self.truth) <= FLAT_SHARE * float(np.nanmax(np.abs(self.wide)))

    @property
    def scale(self) -> float:
        """Scale of slopes: the exact slope or, if it is flat, the largest exact slope over an amplitude or a noise."""
        return float(np.nanmax(np.abs(self.wide))) if self.is_flat else abs(self.truth)


def judge_world(measures: Measures, tolerance: float) -> list[Finding]:
    """Return the verdict as a finding, followed by findings on smoothing and on what to use instead.

    A slope is right if its error is at most ``tolerance`` times the exact slope, at the nominal parameter and at nine
    of ten nearby points. At a kink of the exact output, slopes between those of its two sides are right.
    """
    verdict = _verdict(measures, tolerance * measures.scale)
    biased = [row for row in measures.smoothed if _is_biased(row, tolerance, measures.scale)]
    low, high = measures.sides
    kink = [make_finding("truth-has-a-kink", low=low, high=high)] if high - low > tolerance * measures.scale else []
    # Without samples that are not finite the mean would be that of another function.
    incomplete = [row for row in measures.smoothed if row["nonfinite"]][-1:]
    lost = [make_finding("use-finite-outputs", count=row["nonfinite"], **row) for row in incomplete]
    is_right = verdict.code in ("gradient-right", "gradient-consistent")
    if is_right and not biased:
        return [verdict, *kink, *lost]
    if is_right:
        verdict = make_finding("gradient-biased-at-sigma", slope=measures.slope, **biased[0])
    advice = _advice(measures, tolerance)
    return [verdict, *kink, *([advice] if advice is not None else []), *lost]


def _verdict(measures: Measures, allowed: float) -> Finding:
    """Return the finding of the first test that applies."""
    slope, truth, secants = measures.slope, measures.truth, measures.secants
    numbers: dict[str, Any] = {"slope": slope, "truth": truth}
    if not np.isfinite([slope, *measures.nearby]).all():
        return make_finding("gradient-not-finite", slope=slope)
    right = make_finding("gradient-consistent" if measures.truth_secants is None else "gradient-right", **numbers)
    if _is_constant(measures):
        return right
    # A jump at the nominal parameter looks like rounding errors there.
    if measures.jump is not None:
        size, parameter = measures.jump
        return make_finding("gradient-undefined", size=size, place=parameter, slope=slope)
    if _is_noise(measures, allowed):
        return make_finding("gradient-noise", noise=secants.noise, error=float(secants.errors[-1]), truth=truth)
    if measures.has_gradient and not _is_derivative(measures):
        difference = float(secants.slopes[secants.sharpest])
        return make_finding("gradient-not-the-derivative", difference=difference, **numbers)
    typical = max(abs(slope), float(np.median(np.abs(measures.nearby))))
    if measures.scale > 0 and typical <= ZERO_SHARE * measures.scale:
        wide = max([measures.wide[0], *measures.wide[AGREEING_AMPLITUDES:-2]], key=abs)
        return make_finding("gradient-zero", wide=wide, **numbers)
    return right if _is_right(measures, allowed) else _wrong(measures, allowed)


def _wrong(measures: Measures, allowed: float) -> Finding:
    """Return the finding for a slope that is the derivative of the simulator's output, but not the exact slope."""
    slope, truth, clause = measures.slope, measures.truth, _vanishing_clause(measures)
    nearby: dict[str, Any] = {"low": float(measures.nearby.min()), "high": float(measures.nearby.max())}
    numbers: dict[str, Any] = {"slope": slope, "truth": truth}
    if growth := _growth_clause(measures):
        return make_finding("gradient-exploding", growth=growth, **nearby, **numbers)
    if measures.truth_secants is None:
        return make_finding("gradient-differs-from-secant", **nearby, **numbers)
    if max(slope * side for side in measures.sides) < 0 and abs(slope) > allowed and not measures.is_flat:
        return make_finding("gradient-wrong-sign", vanishes=clause, **nearby, **numbers)
    factor = f"off by {slope - truth:.3g}" if measures.is_flat else f"{slope / truth:.3g} times the exact slope"
    return make_finding("gradient-of-the-discrete-map", factor=factor, vanishes=clause, **nearby, **numbers)


def _is_constant(measures: Measures) -> bool:
    """Return whether the slope is zero, and simulator and exact output are constant, so that it has no scale."""
    slopes = [measures.slope, measures.scale, *measures.nearby, *measures.secants.slopes]
    return not np.any(slopes)


def _is_noise(measures: Measures, allowed: float) -> bool:
    """Return whether a simulator has no derivative, and rounding errors exceed the tolerance in all of its secants."""
    certain = measures.secants.errors < max(allowed, DERIVATIVE_TOLERANCE * float(np.abs(measures.secants.slopes[-1])))
    return not measures.has_gradient and not certain.any()


def _is_derivative(measures: Measures) -> bool:
    """Return whether the slope equals a central or one-sided difference of the output at one of the amplitudes."""
    secants, slope = measures.secants, measures.slope
    allowed = DERIVATIVE_TOLERANCE * max(abs(slope), ZERO_SHARE * measures.scale)
    differences = (secants.slopes, secants.ahead, secants.behind)
    certain = secants.errors < max(allowed, DERIVATIVE_TOLERANCE * measures.scale) * 10
    return any(
        (np.abs(values - slope)[certain] <= allowed + 2 * secants.errors[certain]).any() for values in differences
    )


def _is_right(measures: Measures, allowed: float) -> bool:
    errors = np.abs(measures.nearby - measures.nearby_truth)
    low, high = measures.sides
    return low - allowed <= measures.slope <= high + allowed and float((errors <= allowed).mean()) >= NEARBY_SHARE


def _growth_clause(measures: Measures) -> str | None:
    """Return a clause on how slopes grow with refinement or, exponentially, with the horizon; None if they do not."""
    sizes = [row["typical"] for row in measures.refinements]
    if _grows(sizes, measures.scale):
        return f"each refinement multiplies the slopes by {(sizes[-1] / sizes[0]) ** (1 / (len(sizes) - 1)):.2g}"
    sizes = [row["typical"] for row in measures.horizons]
    if len(sizes) < 3 or not _grows(sizes, measures.scale):
        return None
    name, horizons = next(iter(measures.horizons[0]["settings"])), [row["settings"] for row in measures.horizons]
    rates = np.diff(np.log(sizes)) / np.diff([settings[name] for settings in horizons])
    if rates.min() < STEADY_RATE * rates.max():
        return None
    return f"slopes grow as exp({rates[-1]:.3g} {name})"


def _grows(sizes: Sequence[float], scale: float) -> bool:
    """Return whether sizes grow steadily, to more than twice the scale of slopes."""
    steady = len(sizes) > 1 and all(later >= GROWTH * sooner > 0 for sooner, later in pairwise(sizes))
    return steady and sizes[-1] > 2 * scale


def _vanishing_clause(measures: Measures) -> str:
    """Return a clause that says whether refining the simulator reduces the error of its slope, with numbers."""
    errors = [row["error"] for row in measures.refinements]
    if len(errors) < 2 or not np.isfinite(errors).all():
        return "no refinement of the simulator was tried"
    names = " and ".join(measures.refinements[0]["settings"])
    if _decreases(measures):
        return f"finer {names} lowers the median error nearby from {errors[0]:.2g} to {errors[-1]:.2g}"
    return f"finer {names} does not lower the median error nearby: {errors[0]:.2g}, then {errors[-1]:.2g}"


def _is_biased(row: dict[str, Any], tolerance: float, scale: float) -> bool:
    """Return whether a first-order estimate differs from its reference by more than its interval plus the tolerance."""
    if row["reference"] is None or row["estimator"] != FIRST_ORDER or not np.isfinite(row["mean"]):
        return False
    return abs(row["mean"] - row["reference"]) > row["reliable"] + tolerance * max(abs(row["reference"]), scale)


def _is_reliable(row: dict[str, Any], tolerance: float) -> bool:
    """Return whether error and standard error of an estimate are at most ``tolerance`` times its reference."""
    if not row["reference"] or not np.isfinite(row["mean"]):
        return False
    return max(abs(row["mean"] - row["reference"]), row["standard_error"]) <= tolerance * abs(row["reference"])


def agreeing_amplitudes(measures: Measures, tolerance: float) -> tuple[float, float] | None:
    """Return the smallest and largest amplitude of a range whose secants are right, or None without such a range.

    A secant is right if its error, including rounding, is at most ``tolerance`` times the exact slope. A range has at
    least three consecutive amplitudes; if there are several ranges, the one with the largest amplitudes is returned.
    """
    secants = measures.secants
    if measures.is_flat or measures.jump is not None:
        return None
    errors = np.abs(secants.slopes - measures.truth) + secants.errors
    agree = errors <= tolerance * abs(measures.truth)
    runs = np.split(np.arange(len(agree)), np.flatnonzero(np.diff(agree.astype(int))) + 1)
    long_runs = [run for run in runs if agree[run[0]] and len(run) >= AGREEING_AMPLITUDES]
    if not long_runs:
        return None
    first, last = long_runs[-1][[0, -1]]
    return float(secants.amplitudes[first]), float(secants.amplitudes[last])


def _advice(measures: Measures, tolerance: float) -> Finding | None:
    """Return the advice on what to use instead: a secant, finer settings, a smoothed gradient, or another law.

    It is None if the exact output is unknown, and samples are not finite.
    """
    agreement = "one another" if measures.truth_secants is None else "the exact slope"
    if (amplitudes := agreeing_amplitudes(measures, tolerance)) is not None:
        return make_finding("use-secant", low=amplitudes[0], high=amplitudes[1], agreement=agreement)
    if not measures.is_flat and measures.jump is None and _decreases(measures):
        return make_finding("use-finer", settings=", ".join(measures.refinements[0]["settings"]))
    widest = max(row["sigma"] for row in measures.smoothed)
    if measures.truth_secants is None:
        row = next(row for row in measures.smoothed if row["sigma"] == widest)
        return make_finding("use-estimate", **row) if np.isfinite(row["mean"]) else None
    # A gradient smoothed with less noise than the distance of a jump does not depend on the jump.
    smoothed = [row for row in measures.smoothed if measures.jump is None or row["sigma"] == widest]
    reliable = [row for row in smoothed if _is_reliable(row, tolerance)]
    if reliable:
        best = min(reliable, key=lambda row: row["standard_error"] / abs(row["reference"]))
        return make_finding("use-smoothed", **best)
    counts = [(count, row) for row in smoothed if (count := _needed_samples(row, tolerance)) is not None]
    if counts:
        count, row = min(counts, key=lambda pair: pair[0])
        return make_finding("use-more-samples", count=count, **row)
    return make_finding("use-other-law")


def _needed_samples(row: dict[str, Any], tolerance: float) -> int | None:
    """Return the number of samples at which the standard error meets the tolerance, rounded to two digits.

    It is None unless the estimate agrees with its reference, and only its interval is too wide.
    """
    reference, error = row["reference"] or 0.0, row["standard_error"] / tolerance
    if not abs(row["mean"] - reference) <= row["reliable"] < abs(reference) < error:
        return None
    return int(float(f"{row['n_samples'] * (error / reference) ** 2:.1e}"))


def _decreases(measures: Measures) -> bool:
    """Return whether the error of the slope decreases at each refinement, to less than half of the scale."""
    errors = [row["error"] for row in measures.refinements]
    shrinks = len(errors) > 1 and all(later < sooner for sooner, later in pairwise(errors))
    return shrinks and errors[-1] <= min(DECAY * errors[0], measures.scale / 2)
