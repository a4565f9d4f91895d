"""What P1's data say of fig. 1 and sec. III-A."""

from __future__ import annotations

import numpy as np
import xarray as xr
from scipy.stats import norm

from problems.studies.study import Claim, listed

NAMES = ("drop", "throw", "pivot")


def jumps(data: xr.Dataset, name: str, least: float = 0.1) -> np.ndarray:
    """Decisions at which f jumps by more than ``least`` of its range."""
    f, theta = data[f"f_{name}"].values, data[f"fine_{name}"].values
    return theta[:-1][np.abs(np.diff(f)) > least * np.ptp(f)]


def _bias(data: xr.Dataset, name: str) -> float:
    """Largest error of FoBG over the largest slope."""
    slope = data[f"slope_{name}"].values
    off = np.abs(data[f"first_{name}"].values[:, 0] - slope)
    return float(off.max() / np.abs(slope).max())


def _steps(data: xr.Dataset, name: str) -> float:
    """Largest step of F on its grid over ``spacing range(f)/(sqrt(2 pi) sigma)``.

    An average over N(0, sigma²) of a function of this range has no larger slope.
    """
    step = np.abs(np.diff(data[f"F_{name}"].values)).max()
    spacing = float(data[f"theta_{name}"][1] - data[f"theta_{name}"][0])
    steepest = np.ptp(data[f"f_{name}"].values) * norm.pdf(0, 0, data.attrs[f"sigma_{name}"])
    return float(step / (steepest * spacing))


def _scatter(data: xr.Dataset, name: str) -> tuple[float, float, int]:
    """Mean and root mean square of ZoBG's errors over its standard errors, where F' is not small.

    Without bias the mean is 0 within 1/sqrt(points), told over that, and the other is 1; with the
    number of points.
    """
    estimate, slope = data[f"zeroth_{name}"].values, data[f"slope_{name}"].values
    # Where it is small the jump is met by too few samples for an error of its own.
    steep = np.abs(slope) > 0.3 * np.abs(slope).max()
    score = (estimate[steep, 0] - slope[steep]) / estimate[steep, 1]
    return float(score.mean() * np.sqrt(score.size)), float(np.sqrt(np.mean(score**2))), score.size


def claims(data: xr.Dataset) -> list[Claim]:
    """What fig. 1 and sec. III-A say."""
    found = [_bias(data, name) for name in NAMES]
    offset, scatter, number = np.transpose([_scatter(data, name) for name in NAMES])
    usual = np.all(np.abs(scatter - 1) < 5 / np.sqrt(2 * number)) and np.all(np.abs(offset) < 5)
    reach = data.attrs["v0_throw"] ** 2 / data.attrs["g"]
    flat = float(np.abs(data["first_drop"].values[:, 0]).max())
    throw, tip = jumps(data, "throw"), jumps(data, "pivot")
    expected = np.arctan(data.attrs["length"] / data.attrs["bar"])
    best = int(data["f_throw"].values.argmin())
    raw = [
        float(np.abs(np.diff(data[f"f_{name}"].values)).max() / np.ptp(data[f"f_{name}"].values))
        for name in NAMES
    ]
    smooth = [_steps(data, name) for name in NAMES]
    angle = float(data["fine_throw"][best])

    return [
        Claim("The objectives of all three systems jump", "Pathologies, sec. I, fig. 1",
              "a jump of 10 % or more", f"{listed(raw, '.2f')} of the range within one fine step",
              min(raw) > 0.1),
        Claim("Randomized smoothing makes them continuous", "our check",
              "steps no larger than range(f) spacing/(sqrt(2 pi) sigma)",
              f"{listed(smooth, '.2f')} of it at most", max(smooth) < 1.05),
        Claim("The dropped ball has no gradient almost everywhere", "our check",
              "FoBG = 0", f"largest |FoBG| {flat:g} m/m", flat == 0),
        Claim("FoBG is biased where the objective jumps", "Pathologies, sec. III-A",
              "error beyond its interval", f"error {listed(found, '.2f')} of the largest slope",
              min(found) > 0.2),
        Claim("ZoBG is unbiased", "Pathologies, sec. III-A",
              "errors of 1 standard error, mean 0", f"{listed(scatter, '.2f')} rms, mean"
              f" {listed(offset, '.2f')} of its own standard error", bool(usual)),
        Claim("The throw's best angle is pi/4, away from the wall's jumps", "closed form",
              f"{np.pi / 4:.4f} rad, {-(reach**2):.5f} m²",
              f"{angle:.4f} rad, {float(data['f_throw'][best]):.5f} m²; jumps at"
              f" {listed(throw, '.3f')} rad", bool(abs(angle - np.pi / 4) < 2e-3
                   and np.all(np.abs(throw - angle) > 0.01))),
        Claim("Momentum transfer ends where the ball clears the tip", "closed form",
              f"+-{expected:.4f} rad", f"{listed(tip, '+.4f')} rad",
              bool(len(tip) == 2 and np.allclose(np.abs(tip), expected, atol=1e-3))),
    ]  # fmt: skip
