"""Claims of N2 on Suh et al. 2023, sec. V-B."""

from __future__ import annotations

import numpy as np
import xarray as xr

from ocp import Status
from ocp.judge.referee import COST_SHARE
from problems.studies.start_without_contact.data import LAST, LAWS, PROBLEMS
from problems.studies.study import Claim, claim, format_values, settings_text

_OBJECT_PROGRESS = 0.8
"""Minimum saved fraction of the object's cost of standing still for a plan to count as progress."""


_SMOOTH_DYNAMICS = ("g_sigma", "h", "h_sigma")
"""Names of the dynamics with second derivatives."""
_NO_PROGRESS = 0.01
"""Saved fraction of the object's cost of standing still below which there is no progress."""


def claims(data: xr.Dataset) -> list[Claim]:
    """Return claims on the five dynamics, and on replays of IPOPT's plans."""
    return [
        claim
        for name in PROBLEMS
        for claim in (*learned_gains(name, data.sel(problem=name)), *open_loop(name, data.sel(problem=name)))
    ]


def learned_gains(name: str, data: xr.Dataset) -> list[Claim]:
    """Check the gains that Adam learns for one problem through each of the five dynamics.

    The cost of a seed is the median of its last records; the claims use medians over seeds.
    """
    source = "Noising data, sec. V-B and fig. 2"
    start = float(data["learned"].sel(dynamics="f", end="exact replay").isel(seed=0, step=0))
    last = data["learned"].isel(step=slice(-LAST, None)).median("step")
    exact, model = last.sel(end="exact replay"), last.sel(end="model")
    middle = exact.median("seed")
    final = {str(kind): float(middle.sel(dynamics=kind)) for kind in data["dynamics"].values}
    on_model = {str(kind): float(model.sel(dynamics=kind).median("seed")) for kind in data["dynamics"].values}
    h = on_model["h"] / float(data["learned"].sel(dynamics="h", end="model").isel(step=0).median())
    final_texts = ", ".join(f"{kind} {cost:.4g}" for kind, cost in final.items())
    is_ahead = (exact.sel(dynamics="g_sigma") < exact.sel(dynamics="h_sigma")).values
    swept = data["final"]
    better_than_clean = [kind for kind in ("g_sigma", "h_sigma") if final[kind] < final["h"]]
    is_ahead_swept = swept.sel(swept="g_sigma") < swept.sel(swept="h_sigma")
    rest_cost = float(data["cost"].sel(law="exact", of="at rest"))
    saved = 1 - float(data["object"].sel(dynamics="f").isel(seed=0)) / rest_cost
    return [
        claim(f"{name}: f makes no progress with the object", source)
        .expected(f"the object's cost falls by less than {_NO_PROGRESS:.0%}")
        .measured(f"{saved:.2%} of {rest_cost:.6g}")
        .below(abs(saved), _NO_PROGRESS),
        claim(f"{name}: f_sigma is best under the exact law", source)
        .expected("the lowest of the five")
        .measured(final_texts)
        .holds(min(final, key=lambda kind: final[kind]) == "f_sigma"),
        claim(f"{name}: g_sigma costs less than h_sigma", source)
        .expected("a lower final exact cost at every seed")
        .measured(f"{int(is_ahead.sum())} of {is_ahead.size} seeds; {final['g_sigma']:.4g} and {final['h_sigma']:.4g}")
        .holds(is_ahead),
        claim(f"{name}: it does at all widths of noise and amounts of data", "our check")
        .expected("at every one")
        .measured(f"{int(is_ahead_swept.sum())} of {is_ahead_swept.size}")
        .holds(is_ahead_swept),
        claim(f"{name}: noised data give a lower cost than clean data", source)
        .expected("g_sigma and h_sigma end lower than h")
        .measured(f"{', '.join(better_than_clean) or 'none'} of {final_texts}")
        .equals(len(better_than_clean), 2),
        claim(
            f"{name}: h hardly moves on its own model"
            if name == PROBLEMS[0]
            else f"{name}: h makes some progress on its own model",
            source,
        )
        .expected(
            "less than half of its cost is saved" if name == PROBLEMS[0] else "more than a tenth of its cost is saved"
        )
        .measured(f"{1 - h:.1%}")
        .holds(h > 0.5 if name == PROBLEMS[0] else h < 0.9),
        _ipopt_gains(name, data, on_model),
        _swept_gains(name, data, start),
    ]


def _ipopt_gains(name: str, data: xr.Dataset, on_model: dict[str, float]) -> Claim:
    """Compare gains from IPOPT and from Adam; ``on_model`` maps dynamics to the cost of Adam's gains on them."""
    steps = int(data["step"].values[-1])
    gains = {kind: float(data["gains"].sel(dynamics=kind, end="model")) for kind in _SMOOTH_DYNAMICS}
    work = {kind: int(data["work"].sel(dynamics=kind)) for kind in _SMOOTH_DYNAMICS}
    better = [gains[k] <= (1 + COST_SHARE) * on_model[k] and work[k] < steps for k in _SMOOTH_DYNAMICS]
    work_texts = ", ".join(f"{k} {gains[k]:.4g} after {work[k]}, Adam {on_model[k]:.4g}" for k in _SMOOTH_DYNAMICS)
    return (
        claim(f"{name}: IPOPT finds gains as good on the model with fewer evaluations", "our check")
        .expected(f"within {COST_SHARE:.0%} of Adam's {steps} iterations, where the model is smooth")
        .measured(f"{settings_text(_SMOOTH_DYNAMICS, better)}: {work_texts}")
        .holds(better)
    )


def _swept_gains(name: str, data: xr.Dataset, start: float) -> Claim:
    """Check for each noise width that gains learned through g_sigma save enough of the initial cost ``start``."""
    final = data["final"].sel(swept="g_sigma").isel(amount=-1).values
    reaches_goal = final <= (1 - _OBJECT_PROGRESS) * start
    return (
        claim(f"{name}: what is learned through g_sigma works under the exact law", "our check")
        .expected(f"{_OBJECT_PROGRESS:.0%} of the cost are saved at every width, with all data")
        .measured(settings_text(list(data["width"].values), reaches_goal))
        .holds(reaches_goal)
    )


def open_loop(name: str, data: xr.Dataset) -> list[Claim]:
    """Check the plans of one problem, and their replays, under the exact and smoothed laws."""
    source = "Noising data, sec. V-B and fig. 2"
    smooth = [law for law in LAWS if law != "exact"]
    rest_cost, stuck, _ = (float(v) for v in data["cost"].sel(law="exact"))
    status = str(data["status"].sel(law="exact").values)
    fall = {law: 1 - float(data["cost"].sel(law=law, of="plan")) / rest_cost for law in smooth}
    plan, replay = data["total"].sel(law=smooth).values.T
    dearer = (replay - plan) / np.abs(plan)
    keeps_cost = dearer <= COST_SHARE
    others = [law for law in smooth if law != "randomized"]
    makes_progress = [fall[law] >= _OBJECT_PROGRESS for law in others]
    expected = f"the object's cost falls by {_OBJECT_PROGRESS:.0%} or more"
    return [
        claim(f"{name}: the exact dynamics make no progress from a start without contact", source)
        .expected("the object's cost as at rest")
        .measured(f"{stuck:.6g} of {rest_cost:.6g}, {status}")
        .holds(abs(stuck - rest_cost) <= 1e-9 * rest_cost, status == Status.NO_PROGRESS.label),
        claim(f"{name}: randomized smoothing makes progress", source)
        .expected(expected)
        .measured(f"{fall['randomized']:.1%}")
        .at_least(fall["randomized"], _OBJECT_PROGRESS),
        claim(f"{name}: so do the barrier and the adaptive law", "our check")
        .expected(expected)
        .measured(f"{settings_text(others, makes_progress)}: " + ", ".join(f"{fall[law]:.1%}" for law in others))
        .holds(makes_progress),
        claim(f"{name}: the plan keeps its cost under the exact law", "our check")
        .expected(f"its replay costs at most {COST_SHARE:.0%} more, of all of the cost")
        .measured(f"{settings_text(smooth, keeps_cost)}: " + format_values(dearer, "+.1%"))
        .holds(keeps_cost),
    ]
