"""Claims of A6 on impact, friction and closed forms of the softened box."""

from __future__ import annotations

import numpy as np
import xarray as xr

from problems.studies.study import Claim, claim, format_values, settings_text

_NOISY_ERROR = 0.02
"""Standard error, relative to the slope h/m, above which an average counts as noisy."""


def claims(data: xr.Dataset) -> list[Claim]:
    """Return claims on the impact, on friction, and on the closed forms of the box."""
    return [*_impact_claims(data), *_friction(data), *_closed_forms(data)]


def _impact_claims(data: xr.Dataset) -> list[Claim]:
    h, sigma, jump = data.attrs["h"], data.attrs["sigma"], float(data["jump"])
    quiet, steps = data["quiet"].values, h / data["finer"].values
    counts = data["count"].values
    constant = quiet > 0.8
    pairs = [f"({step:g} s, {count})" for step in steps for count in counts]
    # Expected number of samples that fall into the time step of the impact, for an average centred there.
    expected = steps[:, None] * counts / (sigma * np.sqrt(2 * np.pi))
    rare = expected < 0.1
    least_quiet = quiet[rare].min() if rare.any() else np.nan
    area = data["impact_soft"].values.clip(min=0).sum(axis=1) * h
    laws = [str(law) for law in data["law"].values]
    has_area = np.abs(area / jump - 1) < 0.05
    peak = float(data["impact_soft"].values[-1].max())
    areas = format_values(area[:-1], ".2f")
    return [
        claim("The RS gradient of an impact is constant, with a large bias", "ABS, fig. 6a")
        .expected(f"no impulse, not up to {float(data['impact_limit'].max()):.1f} 1/s, at the step of BS and below")
        .measured(f"(step, N) {settings_text(pairs, constant.ravel())}")
        .holds(constant),
        claim("It is where few samples meet the step of the impact", "our check")
        .expected("no impulse at most points where a tenth of a sample is expected in it")
        .measured(f"at {least_quiet:.0%} or more of the points, in {rare.sum()} of {rare.size} cases")
        .above(least_quiet, 0.8),
        claim("The BS gradient approximates the impulse at contact", "ABS, fig. 6a")
        .expected(f"area {jump:.2f} m/s within 5 %")
        .measured(f"{settings_text(laws[:-1], has_area[:-1])}: {areas} m/s")
        .holds(has_area[:-1]),
        claim("So does the adaptive law's", "our check")
        .expected(f"area {jump:.2f} m/s within 5 %")
        .measured(f"{area[-1]:.2f} m/s, peak {peak:.0f} 1/s")
        .holds(has_area[-1]),
    ]


def _friction(data: xr.Dataset) -> list[Claim]:
    counts, slope = data["count"].values, data.attrs["h_box"]
    few = counts <= 100
    error = data["push_error"].values / slope
    noisy = error > _NOISY_ERROR
    bend = float(np.abs(np.diff(data["push_soft"].values, 2, axis=1)).max())
    rough = np.abs(np.diff(data["push_rs"].values, 2, axis=1)).max(axis=1)
    needed, single = data["cost_needed"].values, data["cost_single"].values
    bias, sigma = data["cost_bias"].values / slope, data["cost_sigma"].values
    mus = format_values(data["box_mu"].values, ".1e")

    return [
        claim("RS gradients of friction are noisy", "ABS, fig. 6b")
        .expected(f"standard error above {_NOISY_ERROR:.0%} of h/m for N <= 100")
        .measured(f"N {settings_text(list(counts), noisy)}: {format_values(error, '.1%')} of h/m")
        .holds(noisy[few]),
        claim("BS gradients of friction are smooth", "ABS, sec. 5.2")
        .expected("second difference below that of RS, N <= 100")
        .measured(f"{bend:.1e} against {format_values(rough, '.1e')} m/(N s) at N = {format_values(counts, 'd')}")
        .below(bend, rough[few]),
        claim("RS is costlier than BS", "ABS, fig. 6b")
        .expected("at noise of equal bias, more than one exact solve for BS's error within a tenth")
        .measured(
            f"{format_values(needed, '.0f')} solves at mu = {mus}; one has {format_values(single, '.2f')} times"
            f" BS's error, which is {format_values(bias, '.1%')} of h/m, as RS's at sigma ="
            f" {format_values(sigma, '.2g')} N"
        )
        .above(needed, 1),
    ]


def _closed_forms(data: xr.Dataset) -> list[Claim]:
    residual, slope = float(data["push_residual"].max()), float(data["slope_residual"].max())
    errors = np.abs(data["push_soft"].values - data["push_exact"].values)
    stepped = float(np.abs(data["push_exact"] - data["push_step"]).max())
    mid, at_step = len(data["u"]) // 2, data["at_step"].values
    mus = " at mu = " + format_values(data["box_mu"].values, ".1e")
    return [
        claim("The exact slope is a step: 0 in stick, h/m in slip", "closed form")
        .expected("0, and h/m for |u| > friction m g")
        .measured(f"off by {stepped:.1e} m/(N s)")
        .below(stepped, 1e-5),
        claim("A barrier on both faces gives v+ = -(2 mu/h) f/(b² - f²)", "closed form")
        .expected("0 m/s")
        .measured(f"{residual:.1e} m/s")
        .below(residual, 1e-9),
        claim("Its slope is (h/m) c/(1 + c), c = (2 m mu/h) (b² + f²)/(b² - f²)²", "closed form")
        .expected("0 m/(N s)")
        .measured(f"{slope:.1e} m/(N s)")
        .below(slope, 1e-8),
        claim("BS of friction tends to the exact slope in stick", "closed form")
        .expected("0 m/(N s) at u = 0")
        .measured(format_values(errors[:, mid], ".1e") + " m/(N s)" + mus)
        .below(errors[:-1, mid], errors[1:, mid] / 5),
        claim("Where the exact slope steps, BS tends to half of the step", "our check")
        .expected("0.5 h/m at u = friction m g")
        .measured(format_values(at_step, ".3f") + " h/m" + mus)
        .holds(np.diff(np.abs(at_step - 0.5)) > 0, abs(at_step[0] - 0.5) < 0.05),
    ]
