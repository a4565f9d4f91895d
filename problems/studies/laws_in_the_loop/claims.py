"""Claims of C1 on planning under a law in a closed loop, and on linear feedback."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import xarray as xr

from problems.studies.laws_in_the_loop.data import FEEDBACK, INPUTS, LAWS, PLANTS, relative_cost, run_settings, survival
from problems.studies.shared.trainings import Difference, mean_difference, smallest_margin
from problems.studies.study import Claim, claim, settings_text

_EQUAL_COST = 0.01
"""Relative difference up to which two mean costs count as equal."""
_CLOSE_COST = 0.1
"""Relative excess of one mean cost over another up to which the two count as close."""
_SETTINGS_SHARE = 0.75
"""Minimum fraction of the settings in which a claim must hold."""
_OUR_CHECK = "our check"
"""Citation in the claims that no paper makes."""
_SHIRAI = "Linear feedback, its title; its abstract: seems not"
"""Citation in the claims on linear feedback."""
_BARRIERS = tuple(law for law in LAWS if law.startswith("barrier"))
"""Names of the barrier laws, from the largest mu to the smallest."""


def claims(data: xr.Dataset) -> list[Claim]:
    """Return claims on the cheapest law, on mu, on linear feedback and on survival."""
    return [*_cheapest(data), *_over_mu(data), *_feedback(data), *_surviving(data)]


def _costs(data: xr.Dataset, span: str, setting: tuple[str, str]) -> dict[str, np.ndarray]:
    """Return a mapping from each controller to its relative costs at a ``setting`` (task, plant), one per seed."""
    costs = relative_cost(data).sel(span=span, task=setting[0], plant=setting[1])
    return {str(name): costs.sel(controller=name).values for name in data["controller"].values}


def _settings_text(settings_run: list[tuple[str, str]], marks: list[bool]) -> str:
    """Return a text with the number of settings in which a claim holds, and a list of the others."""
    missed = [f"{task} on {plant}" for (task, plant), mark in zip(settings_run, marks, strict=True) if not mark]
    return f"{sum(marks)} of {len(marks)} settings" + f"; not {', '.join(missed)}" * bool(missed)


def _cheapest(data: xr.Dataset) -> list[Claim]:
    """Check for each plant that no loop under a smoothed law costs less than the loop under the exact law."""
    results = []
    for plant in PLANTS:
        tasks = [task for task, other in run_settings(data) if other == plant]
        gains = [_exact_gain(_costs(data, "run", (task, plant))) for task in tasks]
        is_cheapest = [bool(gain.mean >= 0) for gain in gains]
        results.append(
            claim(f"{plant}: planning again under the exact law costs the least", _OUR_CHECK)
            .expected(f"its mean cost is within {_EQUAL_COST:.0%} of every smoothed law's, on every task")
            .measured(settings_text(tasks, is_cheapest))
            .holds(is_cheapest and all(is_cheapest), margin=smallest_margin(gains) if gains else None)
        )
    return results


def _exact_gain(costs: dict[str, np.ndarray]) -> Difference:
    """Return the smallest excess of a smoothed law's cost, plus :data:`_EQUAL_COST`, over the exact law's."""
    gains = [mean_difference((1 + _EQUAL_COST) * costs[law], costs["exact"]) for law in list(LAWS)[1:]]
    return min(gains, key=lambda gain: gain.mean)


def _over_mu(data: xr.Dataset) -> list[Claim]:
    """Check that costs decrease with mu and are close to the exact law's costs at the smallest mu."""
    settings_run = run_settings(data)
    means = [
        {law: float(values.mean()) for law, values in _costs(data, "run", setting).items()} for setting in settings_run
    ]
    falls = [all(m[b] <= (1 + _EQUAL_COST) * m[a] for a, b in pairwise(_BARRIERS)) for m in means]
    is_close = [m[_BARRIERS[-1]] <= (1 + _CLOSE_COST) * m["exact"] for m in means]
    return [
        claim("The smaller mu, the less the barrier's loop costs", _OUR_CHECK)
        .expected(
            f"from 0.1 to 0.001 the mean cost never rises by more than {_EQUAL_COST:.0%},"
            f" in {_SETTINGS_SHARE:.0%} of the settings"
        )
        .measured(_settings_text(settings_run, falls))
        .at_least(np.mean(falls), _SETTINGS_SHARE),
        claim("At mu = 0.001 its loop costs no more than that of the exact law", _OUR_CHECK)
        .expected(f"within {_CLOSE_COST:.0%} in the mean, in {_SETTINGS_SHARE:.0%} of the settings")
        .measured(_settings_text(settings_run, is_close))
        .at_least(np.mean(is_close), _SETTINGS_SHARE),
    ]


def _feedback(data: xr.Dataset) -> list[Claim]:
    """Compare linear feedback along one plan with open-loop inputs and with planning again at every sample."""
    settings_run, results = run_settings(data), []
    means = [
        {law: float(values.mean()) for law, values in _costs(data, "first horizon", setting).items()}
        for setting in settings_run
    ]
    for gains, inputs, plan in zip(FEEDBACK, INPUTS, ("exact", "smoothed"), strict=True):
        law = gains.partition(", ")[2]
        better = [m[gains] <= m[inputs] for m in means]
        is_sufficient = [m[gains] <= (1 + _CLOSE_COST) * min(m["exact"], m[law]) for m in means]
        results += [
            claim(f"Linear feedback along the {plan} plan costs less than its inputs alone", _SHIRAI)
            .expected(f"in the mean, in {_SETTINGS_SHARE:.0%} of the settings")
            .measured(_settings_text(settings_run, better))
            .at_least(np.mean(better), _SETTINGS_SHARE),
            claim(f"Linear feedback along the {plan} plan is sufficient", _SHIRAI)
            .expected(
                f"within {_CLOSE_COST:.0%} of planning again, under its law or the exact one, in"
                f" {_SETTINGS_SHARE:.0%} of the settings"
            )
            .measured(_settings_text(settings_run, is_sufficient))
            .at_least(np.mean(is_sufficient), _SETTINGS_SHARE),
        ]
    return results


def _surviving(data: xr.Dataset) -> list[Claim]:
    """Compare the fractions of runs that survive under each law, on the model and on all plants."""
    survivals, settings_run = survival(data).sel(span="run"), run_settings(data)
    shares = {
        law: np.concatenate([survivals.sel(controller=law, task=t, plant=p).values for t, p in settings_run])
        if settings_run
        else np.array([np.nan])
        for law in LAWS
    }
    on_model = [float(survivals.sel(controller=law, plant="model").mean()) for law in LAWS]
    gains = [mean_difference(shares["exact"], shares[law]) for law in list(LAWS)[1:]]
    share_texts = ", ".join(f"{law} {share.mean():.0%}" for law, share in shares.items())
    return [
        claim("On the model every law's loop survives", _OUR_CHECK)
        .expected("every run on every task")
        .measured(settings_text(list(LAWS), np.array(on_model) == 1))
        .equals(np.array(on_model), 1),
        claim("No smoothed law's loop survives more often than that of the exact law", _OUR_CHECK)
        .expected("over all tasks, plants and seeds")
        .measured(share_texts)
        .holds(all(gain.mean >= 0 for gain in gains), margin=smallest_margin(gains)),
    ]
