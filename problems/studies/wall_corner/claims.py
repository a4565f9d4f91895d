"""What P4's data say of ex. III.6 and fig. 4."""

from __future__ import annotations

import numpy as np
import xarray as xr

from problems.studies.study import Claim, listed, over


def _chance(n: int) -> float:
    """Mean square of n scores of an unbiased estimate that chance exceeds by five deviations."""
    return 1 + 5 * np.sqrt(2 / max(n, 1))


def claims(data: xr.Dataset) -> list[Claim]:
    """What ex. III.6 and fig. 4 say."""
    step = np.abs(np.diff(data["f"].values, axis=1)).max(axis=1)
    size = float(data["fine"][1] - data["fine"][0])
    away = np.abs(data["slope"].values[1][0])
    off = data["first"].values[:, :, 0] - data["slope"].values
    score = off / data["first"].values[:, :, 1]
    worst = [int(np.abs(row).argmax()) for row in off]
    near = np.abs(data["theta"].values - float(data["corner"])) < data.attrs["sigma"]
    dome = float(np.mean(score[1][near] ** 2)) if near.any() else np.nan
    zeroth = (data["zeroth"].values[:, :, 0] - data["slope"].values) / data["zeroth"].values[
        :, :, 1
    ]
    rectangle = float(np.mean(zeroth[0] ** 2))
    width, first = data["width"].values, data["narrow_variance_first"].values
    power = float(np.polyfit(np.log(width), np.log(first), 1)[0])
    rough = data["narrow_variance_zeroth"].values
    beta, Delta, scale = (data[f"narrow_{n}"].values for n in ("beta", "Delta", "size"))
    high, biased = first >= 2 * rough, (beta < 0.1) & (Delta > 0.5 * scale)
    place = "Pathologies, ex. III.6"
    return [
        Claim("A rectangular wall makes the objective jump", place, "a jump at the corner",
              f"{step[0]:.3f} m at {float(data['corner']):.4f} rad", bool(step[0] > 0.05)),
        Claim("With a dome it is continuous, but stiff", place, "steep, no jump",
              f"steps of at most {step[1]:.1e} m: slope {step[1] / size:.1f} m/rad against"
              f" {away:.1f} away", bool(step[1] < 1e-2 and step[1] / size > 2 * away)),
        Claim("FoBG is biased at the rectangle", place, "error beyond its interval",
              f"{off[0][worst[0]]:+.2f} m/rad, {abs(score[0][worst[0]]):.0f} standard errors",
              bool(abs(score[0][worst[0]]) > 10)),
        Claim("ZoBG is not", "Pathologies, sec. III-A", "errors of 1 standard error",
              f"{np.sqrt(rectangle):.2f} rms", rectangle < _chance(zeroth[0].size)),
        Claim("With a dome FoBG is no longer biased asymptotically", place,
              "errors of 1 standard error", f"{np.sqrt(dome):.2f} rms near the corner",
              dome < _chance(near.sum())),
        Claim("The stiffness still results in high variance", "our check",
              "twice ZoBG's or more", f"domes {over(list(width), high)} m wide: "
              + listed(first / rough, ".2g") + " times", bool(np.all(high))),
        Claim("It grows as the dome shrinks towards the corner, ZoBG's does not", "our check",
              "as 1/width", f"width to the power {power:.2f}; ZoBG {rough.min():.1f} to"
              f" {rough.max():.1f} m²/rad²",
              bool(-1.3 < power < -0.7 and rough.max() < 3 * rough.min())),
        Claim("The dome results in high empirical bias", place,
              "off by |F'|/2 or more where the dome is missed, in nine of ten cases",
              f"domes {over(list(width), biased)} m wide: met with probability "
              + listed(beta, ".2f") + ", off by "
              + listed(Delta / scale, ".2f") + " of |F'|", bool(np.all(biased))),
        Claim("It does as the dome shrinks", "our check", "the same at the narrowest",
              f"met with probability {beta[-1]:.3f}, off by {Delta[-1] / scale[-1]:.2f} of |F'| at"
              f" {width[-1]:g} m", bool(biased[-1])),
    ]  # fmt: skip
