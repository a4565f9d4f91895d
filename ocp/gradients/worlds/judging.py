"""Verdict on the gradient of a simulator, from tests of its measurements, and advice on what to use instead."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from ocp.gradients.worlds.measures import FIRST_ORDER, Secants
from ocp.judge.findings import Finding, make_finding

ZERO_SHARE = 1e-9
"""Largest slope that counts as zero, as a share of the scale of slopes."""
DERIVATIVE_TOLERANCE = 1e-3
"""Largest relative difference between a derivative and a secant of the same output."""
NEARBY_SHARE = 0.9
"""Share of nearby points whose slope must be right."""
GROWTH = 1.4
"""Minimum factor by which an exploding slope grows at each refinement."""
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
    exact output, or None if it is unknown; the simulator's own secant over the largest amplitude then serves as the
    exact slope.
    """

    slope: float
    nearby: np.ndarray
    truth: float
    nearby_truth: np.ndarray
    secants: Secants
    truth_secants: np.ndarray | None
    has_gradient: bool
    jump: tuple[float, float] | None
    refinements: list[dict[str, Any]]
    smoothed: list[dict[str, Any]]

    @property
    def scale(self) -> float:
        """Scale of slopes: the exact slope or, if it is zero, the largest exact slope over an amplitude or a noise."""
        if self.truth != 0:
            return abs(self.truth)
        wide = self.secants.slopes if self.truth_secants is None else self.truth_secants
        smoothed = [row["reference"] for row in self.smoothed if row["reference"] is not None]
        return float(np.nanmax(np.abs([*wide[-AGREEING_AMPLITUDES:], *smoothed])))


def judge_world(measures: Measures, tolerance: float) -> list[Finding]:
    """Return the verdict as a finding, followed by findings on smoothing and on what to use instead.

    A slope is right if its error is at most ``tolerance`` times the exact slope, at the nominal parameter and at nine
    of ten nearby points.
    """
    verdict = _verdict(measures, tolerance * measures.scale)
    biased = [_smoothed_numbers(row) for row in measures.smoothed if _is_biased(row, tolerance, measures.scale)]
    is_right = verdict.code in ("gradient-right", "gradient-consistent")
    if is_right and biased:
        return [
            make_finding("gradient-biased-at-sigma", slope=measures.slope, **biased[0]),
            _advice(measures, tolerance),
        ]
    if is_right:
        return [verdict]
    return [verdict, _advice(measures, tolerance)]


def _verdict(measures: Measures, allowed: float) -> Finding:
    """Return the finding of the first test that applies."""
    slope, truth, secants = measures.slope, measures.truth, measures.secants
    numbers: dict[str, Any] = {"slope": slope, "truth": truth}
    if not np.isfinite([slope, *measures.nearby]).all():
        return make_finding("gradient-not-finite", slope=slope)
    is_exact_known = measures.truth_secants is not None
    if _is_constant(measures):
        return make_finding("gradient-right" if is_exact_known else "gradient-consistent", **numbers)
    # A jump at the nominal parameter looks like rounding errors there.
    if measures.jump is not None:
        size, place = measures.jump
        return make_finding("gradient-undefined", size=size, place=place, slope=slope)
    if _is_noise(measures, allowed):
        return make_finding("gradient-noise", noise=secants.noise, error=float(secants.errors[-1]), truth=truth)
    if measures.has_gradient and not _is_derivative(measures):
        difference = float(secants.slopes[secants.sharpest])
        return make_finding("gradient-not-the-derivative", difference=difference, **numbers)
    typical = max(abs(slope), float(np.median(np.abs(measures.nearby))))
    if measures.scale > 0 and typical <= ZERO_SHARE * measures.scale:
        return make_finding("gradient-zero", wide=_wide_truth(measures), **numbers)
    if _is_right(measures, allowed):
        return make_finding("gradient-right" if is_exact_known else "gradient-consistent", **numbers)
    return _wrong(measures, allowed)


def _wrong(measures: Measures, allowed: float) -> Finding:
    """Return the finding for a slope that is the derivative of the simulator's output, but not the exact slope."""
    slope, truth, clause = measures.slope, measures.truth, _vanishing_clause(measures)
    nearby: dict[str, Any] = {"low": float(measures.nearby.min()), "high": float(measures.nearby.max())}
    numbers: dict[str, Any] = {"slope": slope, "truth": truth}
    if (growth := _growth(measures)) is not None:
        return make_finding("gradient-exploding", growth=growth, **nearby, **numbers)
    if measures.truth_secants is None:
        return make_finding("gradient-differs-from-secant", **nearby, **numbers)
    if slope * truth < 0 and abs(slope) > allowed:
        return make_finding("gradient-wrong-sign", vanishes=clause, **numbers)
    factor = f"{slope / truth:.3g} times the exact slope" if truth != 0 else f"off by {slope - truth:.3g}"
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
    return abs(measures.slope - measures.truth) <= allowed and float((errors <= allowed).mean()) >= NEARBY_SHARE


def _growth(measures: Measures) -> float | None:
    """Return the factor by which slopes grow per refinement, or None if they do not grow steadily."""
    sizes = [row["typical"] for row in measures.refinements]
    if len(sizes) < 2 or not all(later >= GROWTH * sooner > 0 for sooner, later in pairwise(sizes)):
        return None
    return (sizes[-1] / sizes[0]) ** (1 / (len(sizes) - 1)) if sizes[-1] > 2 * measures.scale else None


def _vanishing_clause(measures: Measures) -> str:
    """Return a clause that says whether refining the simulator reduces the error of its slope, with numbers."""
    errors = [row["error"] for row in measures.refinements]
    if len(errors) < 2 or not np.isfinite(errors).all():
        return "no refinement of the simulator was tried"
    names = " and ".join(measures.refinements[0]["settings"])
    if _decreases(measures):
        return f"finer {names} lowers the error from {errors[0]:.2g} to {errors[-1]:.2g}"
    return f"finer {names} does not lower the error: {errors[0]:.2g}, then {errors[-1]:.2g}"


def _wide_truth(measures: Measures) -> float:
    """Return the largest, in absolute value, of the secant over the largest amplitude and the smoothed gradients."""
    wide = measures.secants.slopes if measures.truth_secants is None else measures.truth_secants
    smoothed = [row["reference"] for row in measures.smoothed if row["reference"] is not None]
    return max((float(wide[-1]), *smoothed), key=abs)


def _smoothed_numbers(row: dict[str, Any]) -> dict[str, Any]:
    return {key: row[key] for key in ("estimator", "sigma", "mean", "standard_error", "reference")}


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
    if measures.truth == 0 or measures.jump is not None:
        return None
    errors = np.abs(secants.slopes - measures.truth) + secants.errors
    agree = errors <= tolerance * abs(measures.truth)
    runs = np.split(np.arange(len(agree)), np.flatnonzero(np.diff(agree.astype(int))) + 1)
    long_runs = [run for run in runs if agree[run[0]] and len(run) >= AGREEING_AMPLITUDES]
    if not long_runs:
        return None
    first, last = long_runs[-1][[0, -1]]
    return float(secants.amplitudes[first]), float(secants.amplitudes[last])


def _advice(measures: Measures, tolerance: float) -> Finding:
    """Return the advice on what to use instead: a secant, finer settings, a smoothed gradient, or another law."""
    agreement = "one another" if measures.truth_secants is None else "the exact slope"
    if (amplitudes := agreeing_amplitudes(measures, tolerance)) is not None:
        return make_finding("use-secant", low=amplitudes[0], high=amplitudes[1], agreement=agreement)
    if measures.truth != 0 and measures.jump is None and _decreases(measures):
        return make_finding("use-finer", settings=", ".join(measures.refinements[0]["settings"]))
    widest = max(row["sigma"] for row in measures.smoothed)
    if measures.truth_secants is None:
        row = next(row for row in measures.smoothed if row["sigma"] == widest)
        code = "use-estimate" if np.isfinite(row["mean"]) else "use-finite-outputs"
        return make_finding(code, **_smoothed_numbers(row), count=row["nonfinite"])
    # A gradient smoothed with less noise than the distance of a jump does not depend on the jump.
    smoothed = [row for row in measures.smoothed if measures.jump is None or row["sigma"] == widest]
    reliable = [row for row in smoothed if _is_reliable(row, tolerance)]
    if reliable:
        best = min(reliable, key=lambda row: row["standard_error"] / abs(row["reference"]))
        return make_finding("use-smoothed", **_smoothed_numbers(best))
    samples = [(_needed_samples(row, tolerance), row) for row in smoothed if _is_undecided(row, tolerance)]
    if samples:
        count, row = min(samples, key=lambda pair: pair[0])
        return make_finding("use-more-samples", count=count, **_smoothed_numbers(row))
    return make_finding("use-other-law")


def _is_undecided(row: dict[str, Any], tolerance: float) -> bool:
    """Return whether an estimate needs more samples: it agrees with its reference, but its interval is too wide."""
    size = abs(row["reference"] or 0.0)
    return abs(row["mean"] - (row["reference"] or 0.0)) <= row["reliable"] < size < row["standard_error"] / tolerance


def _needed_samples(row: dict[str, Any], tolerance: float) -> int:
    """Return the number of samples at which the standard error meets the tolerance, rounded to two digits."""
    count = row["n_samples"] * (row["standard_error"] / (tolerance * row["reference"])) ** 2
    return int(float(f"{count:.1e}"))


def _decreases(measures: Measures) -> bool:
    """Return whether the error of the slope decreases at each refinement, to less than half of the scale."""
    errors = [row["error"] for row in measures.refinements]
    shrinks = len(errors) > 1 and all(later < sooner for sooner, later in pairwise(errors))
    return shrinks and errors[-1] <= min(DECAY * errors[0], measures.scale / 2)
