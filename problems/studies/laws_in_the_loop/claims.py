"""What C1's data say of planning under a law in a closed loop, and of linear feedback."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import xarray as xr

from problems.studies.laws_in_the_loop.data import (
    FEEDBACK,
    INPUTS,
    LAWS,
    PLANTS,
    relative,
    settings,
    survives,
)
from problems.studies.shared.trainings import Difference, difference, least
from problems.studies.study import Claim, claim, over

_SAME = 0.01
"""Mean costs that differ by no more than this are the same."""
_CLOSE = 0.1
"""How much dearer than planning again feedback may be, to be sufficient."""
_MOSTLY = 0.75
"""Share of the settings in which a sentence about all of them is said."""
_CHECK, _SHIRAI = "our check", "Linear feedback, its title; its abstract: seems not"
_BARRIERS = tuple(law for law in LAWS if law.startswith("barrier"))


def claims(data: xr.Dataset) -> list[Claim]:
    """Which law to plan with again, what mu does, whether gains suffice, and who survives."""
    return [*_cheapest(data), *_over_mu(data), *_feedback(data), *_surviving(data)]


def _costs(data: xr.Dataset, span: str, setting: tuple[str, str]) -> dict[str, np.ndarray]:
    """Costs over the best of all seeds, by controller, at a task and a plant."""
    costs = relative(data).sel(span=span, task=setting[0], plant=setting[1])
    return {str(name): costs.sel(controller=name).values for name in data["controller"].values}


def _told(settings_run: list[tuple[str, str]], marks: list[bool]) -> str:
    """In how many settings it held, and in which it did not."""
    missed = [f"{task} on {plant}" for (task, plant), mark in zip(settings_run, marks, strict=True) if not mark]
    return f"{sum(marks)} of {len(marks)} settings" + f"; not {', '.join(missed)}" * bool(missed)


def _cheapest(data: xr.Dataset) -> list[Claim]:
    """Of each plant: whether no smoothed law's loop is cheaper than the exact law's."""
    results = []
    for plant in PLANTS:
        tasks = [task for task, other in settings(data) if other == plant]
        gains = [_ahead(_costs(data, "run", (task, plant))) for task in tasks]
        is_cheapest = [bool(gain.mean >= 0) for gain in gains]
        results.append(
            claim(f"{plant}: planning again under the exact law costs the least", _CHECK)
            .expected(f"its mean cost is within {_SAME:.0%} of every smoothed law's, on every task")
            .measured(over(tasks, is_cheapest))
            .holds(is_cheapest and all(is_cheapest), margin=least(gains) if gains else None)
        )
    return results


def _ahead(costs: dict[str, np.ndarray]) -> Difference:
    """By how much the cheapest smoothed law is dearer than the exact one, less what is the same."""
    gains = [difference((1 + _SAME) * costs[law], costs["exact"]) for law in list(LAWS)[1:]]
    return min(gains, key=lambda gain: gain.mean)


def _over_mu(data: xr.Dataset) -> list[Claim]:
    """The order of the barriers, and how close the sharpest is to the exact law."""
    settings_run = settings(data)
    means = [
        {law: float(values.mean()) for law, values in _costs(data, "run", setting).items()} for setting in settings_run
    ]
    falls = [all(m[b] <= (1 + _SAME) * m[a] for a, b in pairwise(_BARRIERS)) for m in means]
    is_close = [m[_BARRIERS[-1]] <= (1 + _CLOSE) * m["exact"] for m in means]
    return [
        claim("The smaller mu, the less the barrier's loop costs", _CHECK)
        .expected(
            f"from 0.1 to 0.001 the mean cost never rises by more than {_SAME:.0%}, in {_MOSTLY:.0%} of the settings"
        )
        .measured(_told(settings_run, falls))
        .at_least(np.mean(falls), _MOSTLY),
        claim("At mu = 0.001 its loop costs no more than that of the exact law", _CHECK)
        .expected(f"within {_CLOSE:.0%} in the mean, in {_MOSTLY:.0%} of the settings")
        .measured(_told(settings_run, is_close))
        .at_least(np.mean(is_close), _MOSTLY),
    ]


def _feedback(data: xr.Dataset) -> list[Claim]:
    """Gains along one plan, against its inputs alone and against planning again."""
    settings_run, results = settings(data), []
    means = [
        {law: float(values.mean()) for law, values in _costs(data, "first horizon", setting).items()}
        for setting in settings_run
    ]
    for gains, inputs, plan in zip(FEEDBACK, INPUTS, ("exact", "smoothed"), strict=True):
        law = gains.partition(", ")[2]
        better = [m[gains] <= m[inputs] for m in means]
        is_sufficient = [m[gains] <= (1 + _CLOSE) * min(m["exact"], m[law]) for m in means]
        results += [
            claim(f"Linear feedback along the {plan} plan costs less than its inputs alone", _SHIRAI)
            .expected(f"in the mean, in {_MOSTLY:.0%} of the settings")
            .measured(_told(settings_run, better))
            .at_least(np.mean(better), _MOSTLY),
            claim(f"Linear feedback along the {plan} plan is sufficient", _SHIRAI)
            .expected(
                f"within {_CLOSE:.0%} of planning again, under its law or the exact one, in"
                f" {_MOSTLY:.0%} of the settings"
            )
            .measured(_told(settings_run, is_sufficient))
            .at_least(np.mean(is_sufficient), _MOSTLY),
        ]
    return results


def _surviving(data: xr.Dataset) -> list[Claim]:
    """Whose loops survive, where the plant is the model and over all plants."""
    survivals, settings_run = survives(data).sel(span="run"), settings(data)
    shares = {
        law: np.concatenate([survivals.sel(controller=law, task=t, plant=p).values for t, p in settings_run])
        if settings_run
        else np.array([np.nan])
        for law in LAWS
    }
    on_model = [float(survivals.sel(controller=law, plant="model").mean()) for law in LAWS]
    gains = [difference(shares["exact"], shares[law]) for law in list(LAWS)[1:]]
    share_texts = ", ".join(f"{law} {share.mean():.0%}" for law, share in shares.items())
    return [
        claim("On the model every law's loop survives", _CHECK)
        .expected("every run on every task")
        .measured(over(list(LAWS), np.array(on_model) == 1))
        .equals(np.array(on_model), 1),
        claim("No smoothed law's loop survives more often than that of the exact law", _CHECK)
        .expected("over all tasks, plants and seeds")
        .measured(share_texts)
        .holds(all(gain.mean >= 0 for gain in gains), margin=least(gains)),
    ]
