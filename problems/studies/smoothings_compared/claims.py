"""Claims of N3 on the choice of a smoothing."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr

from problems.studies.smoothings_compared.data import ANALYTIC, LEARNED, WITHIN, excess_cost, replay_gap
from problems.studies.study import Claim, claim, settings_text

_PROGRESS_SHARE = 0.8
"""Minimum fraction of the cost of standing still that a plan must save, under its own law, to count as progress."""
_EQUAL_EXCESS = 0.01
"""Relative difference up to which two costs count as equal."""
_SEED_SPREAD = 1.5
"""Ratio of the largest to the smallest exact cost over seeds up to which plans count as the same."""
_PLANS_SHARE = 0.75
"""Minimum fraction of the plans for which a claim must hold."""
_SHARP_LAWS = ("barrier", "sharp barrier", "adaptive")
"""Names of the analytic laws that are close to the exact law."""
_OUR_CHECK = "our check"
"""Citation in the claims that no paper makes."""


def claims(data: xr.Dataset) -> list[Claim]:
    """Return claims on progress, exact cost, learned laws, seeds, survival and trust."""
    return [*_progress(data), *_close(data), *_learned(data), *_seeds(data), *_surviving(data), *_trust(data)]


def _names(data: xr.Dataset) -> list[str]:
    return [str(name) for name in data["problem"].values]


def _each(names: Sequence[str], values: np.ndarray, form: str) -> str:
    """Return a text with each name and its value: ``push-1d +1.4%, push-disc +44%``."""
    return ", ".join(f"{name} {format(v, form)}" for name, v in zip(names, values, strict=True))


def _middle(values: xr.DataArray) -> xr.DataArray:
    return values.median("seed", skipna=False)


def _progress(data: xr.Dataset) -> list[Claim]:
    saved = _middle(1 - data["cost"].sel(motion="plan") / data["rest"])
    expected = f"on its own model it saves {_PROGRESS_SHARE:.0%} or more of the cost at rest"
    results = []
    for name in ("planar-push", "planar-hand"):
        for kind, laws in (("analytic smoothing", ANALYTIC), ("learned law", LEARNED)):
            shares = saved.sel(problem=name, law=list(laws)).values
            makes_progress = shares >= _PROGRESS_SHARE
            results.append(
                claim(f"{name}: every {kind} makes progress from a start without contact", _OUR_CHECK)
                .expected(expected)
                .measured(_each(laws, shares, ".0%"))
                .holds(makes_progress)
            )
    return results


def _close(data: xr.Dataset) -> list[Claim]:
    """Compare the exact cost of each law's plan with the exact optimum, and check that it decreases with mu."""
    names, excesses = _names(data), _middle(excess_cost(data))
    others = excesses.drop_sel(law="exact").min("law", skipna=False).values
    expected = f"its exact replay costs at most {WITHIN:.0%} more, on every problem"
    results = [
        claim("No law's plan is cheaper under the exact law than the exact law's own", _OUR_CHECK)
        .expected(f"by more than {_EQUAL_EXCESS:.0%}, on any problem")
        .measured(f"cheapest of the others: {_each(names, others, '+.1%')}")
        .at_least(others, -_EQUAL_EXCESS)
    ]
    for law in ANALYTIC:
        shares = excesses.sel(law=law).values
        is_close = shares <= WITHIN
        results.append(
            claim(f"{law}: the plan is close to the exact optimum", _OUR_CHECK)
            .expected(expected)
            .measured(_each(names, shares, "+.1%"))
            .holds(is_close)
        )
    by_mu = excesses.sel(law=["gentle barrier", "barrier", "sharp barrier"]).transpose("problem", ...)
    falls = np.all(np.diff(by_mu.values) <= _EQUAL_EXCESS, axis=1)
    hand = excesses.sel(problem="planar-hand", law=list(ANALYTIC)).values
    return [
        *results,
        claim("The smaller mu, the closer the barrier's plan is to the exact optimum", _OUR_CHECK)
        .expected(f"the excess never rises by more than {_EQUAL_EXCESS:.0%}")
        .measured(settings_text(names, falls))
        .holds(falls),
        claim("planar-hand: no smoothing comes close to the exact optimum", _OUR_CHECK)
        .expected(f"each costs more than {WITHIN:.0%} more")
        .measured(_each(ANALYTIC, hand, "+.0%"))
        .above(hand, WITHIN),
    ]


def _learned(data: xr.Dataset) -> list[Claim]:
    names, excesses = _names(data), _middle(excess_cost(data))
    cheapest = excesses.sel(law=list(LEARNED)).min("law", skipna=False).values
    sharp = excesses.sel(law=list(_SHARP_LAWS)).max("law", skipna=False).values
    worse = cheapest > sharp
    clean, noised = (excesses.sel(law=f"{kind} mlp").values for kind in ("clean", "noised"))
    better = noised < clean
    return [
        claim("Every learned law's plan costs more under the exact law than analytic ones", _OUR_CHECK)
        .expected(f"the cheapest of them more than the dearest of {', '.join(_SHARP_LAWS)}")
        .measured(f"times the optimum: {_each(names, 1 + cheapest, '.3g')}; against {_each(names, 1 + sharp, '.3g')}")
        .holds(worse),
        claim("Noise on its data makes a network's plan cheaper under the exact law", "Noising data, sec. V-B")
        .expected("on every problem")
        .measured(f"times the optimum: {_each(names, 1 + noised, '.3g')}; clean {_each(names, 1 + clean, '.3g')}")
        .holds(better),
    ]


def _seeds(data: xr.Dataset) -> list[Claim]:
    """Check that plans for different seeds, with other data, initial weights or noise, have similar costs."""
    replay, results = data["cost"].sel(motion="exact replay"), []
    spread = replay.max("seed", skipna=False) / replay.min("seed", skipna=False)
    for kind, laws in (("the randomized law", ("randomized",)), ("a learned law", LEARNED)):
        worst = spread.sel(law=list(laws)).max("problem", skipna=False).values
        alike = (worst <= _SEED_SPREAD) & (data.sizes["seed"] > 1)
        results.append(
            claim(f"Another seed of {kind} gives a plan of about the same exact cost", _OUR_CHECK)
            .expected(
                f"the dearest of {data.sizes['seed']} is at most {_SEED_SPREAD:g} times the cheapest, on every problem"
            )
            .measured(f"times, at worst: {_each(laws, worst, '.3g')}")
            .holds(alike)
        )
    return results


def _surviving(data: xr.Dataset) -> list[Claim]:
    """Check that plans that survive the referee are close to the exact optimum."""
    best = data["cost"].sel(law="exact", motion="exact replay")
    trusting = data["trusting_cost"].sel(motion="exact replay") / best - 1
    analytic, learned = (
        _survivors(data["survives"].sel(law=list(laws)), excess_cost(data).sel(law=list(laws)))
        for laws in (ANALYTIC, LEARNED)
    )
    learned = np.append(learned, _survivors(data["trusting_survives"], trusting))
    results = []
    for kind, shares in (("an analytic law", analytic), ("a learned law", learned)):
        n_close = int(np.sum(shares <= WITHIN))
        results.append(
            claim(f"A surviving plan of {kind} is close to the exact optimum", _OUR_CHECK)
            .expected(f"its exact replay costs at most {WITHIN:.0%} more, trust of any weight included")
            .measured(f"{n_close} of {len(shares)} surviving plans")
            .holds(0 < len(shares) == n_close)
        )
    return results


def _survivors(survives: xr.DataArray, shares: xr.DataArray) -> np.ndarray:
    """Return the excess costs of the plans that survive."""
    return shares.transpose(*survives.dims).values[survives.values == 1]


def _trust(data: xr.Dataset) -> list[Claim]:
    names, cost, shares = _names(data), data["trusting_cost"], data["share"].values
    gaps = replay_gap(cost).transpose("share", "problem", "seed").values
    narrower = gaps[-1] < gaps[0]
    plan, replay = (_middle(cost.sel(motion=m)).transpose("problem", "share").values for m in ("plan", "exact replay"))
    ratio = replay[:, 1:] / replay[:, :1]
    helped = ratio.min(axis=1) <= 1 - WITHIN
    best_weights = [f"{shares[1:][i]:g}" for i in ratio.argmin(axis=1)]
    cost_ratio = plan[:, -1] / plan[:, 0]
    return [
        claim("Trust brings the replay nearer to the plan", _OUR_CHECK)
        .expected(f"at its largest weight the gap is smaller than without in {_PLANS_SHARE:.0%} of plans")
        .measured(
            f"{narrower.sum()} of {narrower.size}; medians"
            f" {_each(names, np.median(gaps[-1], axis=1), '+.0%')}; without"
            f" {_each(names, np.median(gaps[0], axis=1), '+.0%')}"
        )
        .at_least(np.mean(narrower), _PLANS_SHARE),
        claim("Trust makes the plan cheaper under the exact law", _OUR_CHECK)
        .expected(f"by {WITHIN:.0%} or more, at one weight at least, on every problem")
        .measured(f"{_each(names, ratio.min(axis=1) - 1, '+.0%')}, at {', '.join(best_weights)}")
        .holds(helped),
        claim("Too much trust raises the cost of the task", _OUR_CHECK)
        .expected(f"at its largest weight the plan costs {WITHIN:.0%} or more more on its own model")
        .measured(f"times: {_each(names, cost_ratio, '.3g')}")
        .at_least(cost_ratio, 1 + WITHIN),
    ]
