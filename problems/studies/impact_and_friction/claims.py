"""What A6's data say of fig. 6 and of the box's closed forms."""

from __future__ import annotations

import numpy as np
import xarray as xr

from problems.studies.study import Claim, listed, over

_NOISY = 0.02
"""Standard error over h/m from which an average is noisy."""


def claims(data: xr.Dataset) -> list[Claim]:
    """The impact, friction, and what the closed forms say of the box."""
    return [*_impact(data), *_friction(data), *_closed_forms(data)]


def _impact(data: xr.Dataset) -> list[Claim]:
    h, sigma, jump = data.attrs["h"], data.attrs["sigma"], float(data["jump"])
    quiet, steps = data["quiet"].values, h / data["finer"].values
    counts = data["count"].values
    constant = quiet > 0.8
    pairs = [f"({step:g} s, {count})" for step in steps for count in counts]
    # Samples expected in the one step of the impact, at its middle.
    expected = steps[:, None] * counts / (sigma * np.sqrt(2 * np.pi))
    rare = expected < 0.1
    seen = quiet[rare].min() if rare.any() else np.nan
    area = data["impact_soft"].values.clip(min=0).sum(axis=1) * h
    laws = [str(law) for law in data["law"].values]
    close = np.abs(area / jump - 1) < 0.05
    peak = float(data["impact_soft"].values[-1].max())
    areas = listed(area[:-1], ".2f")
    return [
        Claim("The RS gradient of an impact is constant, with a large bias", "ABS, fig. 6a",
              f"no impulse, not up to {float(data['impact_limit'].max()):.1f} 1/s, at the step of"
              " BS and below", f"(step, N) {over(pairs, constant.ravel())}",
              bool(np.all(constant))),
        Claim("It is where few samples meet the step of the impact", "our check",
              "no impulse at most points where a tenth of a sample is expected in it",
              f"at {seen:.0%} or more of the points, in {rare.sum()} of {rare.size} cases",
              bool(seen > 0.8)),
        Claim("The BS gradient approximates the impulse at contact", "ABS, fig. 6a",
              f"area {jump:.2f} m/s within 5 %", f"{over(laws[:-1], close[:-1])}: {areas} m/s",
              bool(np.all(close[:-1]))),
        Claim("So does the adaptive law's", "our check", f"area {jump:.2f} m/s within 5 %",
              f"{area[-1]:.2f} m/s, peak {peak:.0f} 1/s",
              bool(close[-1])),
    ]  # fmt: skip


def _friction(data: xr.Dataset) -> list[Claim]:
    counts, slope = data["count"].values, data.attrs["h_box"]
    few = counts <= 100
    error = data["push_error"].values / slope
    noisy = error > _NOISY
    bend = float(np.abs(np.diff(data["push_soft"].values, 2, axis=1)).max())
    rough = np.abs(np.diff(data["push_rs"].values, 2, axis=1)).max(axis=1)
    needed, single = data["cost_needed"].values, data["cost_single"].values
    bias, sigma = data["cost_bias"].values / slope, data["cost_sigma"].values
    mus = listed(data["box_mu"].values, ".1e")

    return [
        Claim("RS gradients of friction are noisy", "ABS, fig. 6b",
              f"standard error above {_NOISY:.0%} of h/m for N <= 100",
              f"N {over(list(counts), noisy)}: {listed(error, '.1%')} of h/m",
              bool(np.all(noisy[few]))),
        Claim("BS gradients of friction are smooth", "ABS, sec. 5.2",
              "second difference below that of RS, N <= 100",
              f"{bend:.1e} against {listed(rough, '.1e')} m/(N s) at N = {listed(counts, 'd')}",
              bool(np.all(bend < rough[few]))),
        Claim("RS is costlier than BS", "ABS, fig. 6b",
              "at noise of equal bias, more than one exact solve for BS's error within a tenth",
              f"{listed(needed, '.0f')} solves at mu = {mus}; one has {listed(single, '.2f')} times"
              f" BS's error, which is {listed(bias, '.1%')} of h/m, as RS's at sigma ="
              f" {listed(sigma, '.2g')} N", bool(np.all(needed > 1))),
    ]  # fmt: skip


def _closed_forms(data: xr.Dataset) -> list[Claim]:
    residual, slope = float(data["push_residual"].max()), float(data["slope_residual"].max())
    off = np.abs(data["push_soft"].values - data["push_exact"].values)
    stepped = float(np.abs(data["push_exact"] - data["push_step"]).max())
    mid, at_step = len(data["u"]) // 2, data["at_step"].values
    mus = " at mu = " + listed(data["box_mu"].values, ".1e")
    return [
        Claim("The exact slope is a step: 0 in stick, h/m in slip", "closed form",
              "0, and h/m for |u| > friction m g", f"off by {stepped:.1e} m/(N s)",
              stepped < 1e-5),
        Claim("A barrier on both faces gives v+ = -(2 mu/h) f/(b² - f²)", "closed form", "0 m/s",
              f"{residual:.1e} m/s", residual < 1e-9),
        Claim("Its slope is (h/m) c/(1 + c), c = (2 m mu/h) (b² + f²)/(b² - f²)²", "closed form",
              "0 m/(N s)", f"{slope:.1e} m/(N s)", slope < 1e-8),
        Claim("BS of friction tends to the exact slope in stick", "closed form",
              "0 m/(N s) at u = 0", listed(off[:, mid], ".1e") + " m/(N s)" + mus,
              bool(np.all(off[:-1, mid] < off[1:, mid] / 5))),
        Claim("Where the exact slope steps, BS tends to half of the step", "our check",
              "0.5 h/m at u = friction m g", listed(at_step, ".3f") + " h/m" + mus,
              bool(np.all(np.diff(np.abs(at_step - 0.5)) > 0) and abs(at_step[0] - 0.5) < 0.05)),
    ]  # fmt: skip
