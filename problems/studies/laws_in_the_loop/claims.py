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


def _costs(data: xr.Dataset, span: str, at: tuple[str, str]) -> dict[str, np.ndarray]:
    """Costs over the best of all seeds, by controller, at a task and a plant."""
    found = relative(data).sel(span=span, task=at[0], plant=at[1])
    return {str(name): found.sel(controller=name).values for name in data["controller"].values}


def _told(where: list[tuple[str, str]], held: list[bool]) -> str:
    """In how many settings it held, and in which it did not."""
    missed = [f"{task} on {plant}" for (task, plant), mark in zip(where, held, strict=True) if not mark]
    return f"{sum(held)} of {len(held)} settings" + f"; not {', '.join(missed)}" * bool(missed)


def _cheapest(data: xr.Dataset) -> list[Claim]:
    """Of each plant: whether no smoothed law's loop is cheaper than the exact law's."""
    found = []
    for plant in PLANTS:
        tasks = [task for task, other in settings(data) if other == plant]
        gains = [_ahead(_costs(data, "run", (task, plant))) for task in tasks]
        held = [bool(gain.mean >= 0) for gain in gains]
        found.append(
            claim(f"{plant}: planning again under the exact law costs the least", _CHECK)
            .expected(f"its mean cost is within {_SAME:.0%} of every smoothed law's, on every task")
            .measured(over(tasks, held))
            .holds(held and all(held), margin=least(gains) if gains else None)
        )
    return found


def _ahead(costs: dict[str, np.ndarray]) -> Difference:
    """By how much the cheapest smoothed law is dearer than the exact one, less what is the same."""
    gains = [difference((1 + _SAME) * costs[law], costs["exact"]) for law in list(LAWS)[1:]]
    return min(gains, key=lambda gain: gain.mean)


def _over_mu(data: xr.Dataset) -> list[Claim]:
    """The order of the barriers, and how close the sharpest is to the exact law."""
    where = settings(data)
    means = [{law: float(values.mean()) for law, values in _costs(data, "run", at).items()} for at in where]
    falls = [all(m[b] <= (1 + _SAME) * m[a] for a, b in pairwise(_BARRIERS)) for m in means]
    close = [m[_BARRIERS[-1]] <= (1 + _CLOSE) * m["exact"] for m in means]
    return [
        claim("The smaller mu, the less the barrier's loop costs", _CHECK)
        .expected(
            f"from 0.1 to 0.001 the mean cost never rises by more than {_SAME:.0%}, in {_MOSTLY:.0%} of the settings"
        )
        .measured(_told(where, falls))
        .at_least(np.mean(falls), _MOSTLY),
        claim("At mu = 0.001 its loop costs no more than that of the exact law", _CHECK)
        .expected(f"within {_CLOSE:.0%} in the mean, in {_MOSTLY:.0%} of the settings")
        .measured(_told(where, close))
        .at_least(np.mean(close), _MOSTLY),
    ]


def _feedback(data: xr.Dataset) -> list[Claim]:
    """Gains along one plan, against its inputs alone and against planning again."""
    where, found = settings(data), []
    means = [{law: float(values.mean()) for law, values in _costs(data, "first horizon", at).items()} for at in where]
    for gains, inputs, plan in zip(FEEDBACK, INPUTS, ("exact", "smoothed"), strict=True):
        law = gains.partition(", ")[2]
        better = [m[gains] <= m[inputs] for m in means]
        enough = [m[gains] <= (1 + _CLOSE) * min(m["exact"], m[law]) for m in means]
        found += [
            claim(f"Linear feedback along the {plan} plan costs less than its inputs alone", _SHIRAI)
            .expected(f"in the mean, in {_MOSTLY:.0%} of the settings")
            .measured(_told(where, better))
            .at_least(np.mean(better), _MOSTLY),
            claim(f"Linear feedback along the {plan} plan is sufficient", _SHIRAI)
            .expected(
                f"within {_CLOSE:.0%} of planning again, under its law or the exact one, in"
                f" {_MOSTLY:.0%} of the settings"
            )
            .measured(_told(where, enough))
            .at_least(np.mean(enough), _MOSTLY),
        ]
    return found


def _surviving(data: xr.Dataset) -> list[Claim]:
    """Whose loops survive, where the plant is the model and over all plants."""
    alive, where = survives(data).sel(span="run"), settings(data)
    shares = {
        law: np.concatenate([alive.sel(controller=law, task=t, plant=p).values for t, p in where])
        if where
        else np.array([np.nan])
        for law in LAWS
    }
    own = [float(alive.sel(controller=law, plant="model").mean()) for law in LAWS]
    gains = [difference(shares["exact"], shares[law]) for law in list(LAWS)[1:]]
    told = ", ".join(f"{law} {share.mean():.0%}" for law, share in shares.items())
    return [
        claim("On the model every law's loop survives", _CHECK)
        .expected("every run on every task")
        .measured(over(list(LAWS), np.array(own) == 1))
        .equals(np.array(own), 1),
        claim("No smoothed law's loop survives more often than that of the exact law", _CHECK)
        .expected("over all tasks, plants and seeds")
        .measured(told)
        .holds(all(gain.mean >= 0 for gain in gains), margin=least(gains)),
    ]
