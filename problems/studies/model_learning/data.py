"""AM: one-step errors over transitions, psi against a network, and psi with its intervals."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import xarray as xr

from problems.studies.model_learning.models import (
    DATA,
    PSI,
    Source,
    by_network,
    by_psi,
    in_flight,
)
from problems.studies.study import Pieces, StudyParams, quantity_of, setting

WHERE = ("all", "flight", "contact")
MODELS = ("psi", "network")
MIXED = "m, rad, m/s, rad/s"


class Params(StudyParams):
    """Parameters of AM; the paper's text has none, those of the network are its code's."""

    data: int = setting(2000, "1", "transitions, of which a 40th, a 10th, a 4th are fewer",
                        least=400)  # fmt: skip
    held: int = setting(1000, "1", "held-out transitions", least=50)
    seeds: int = setting(3, "1", "starts of psi and of networks", least=1, most=20)
    noise: float = setting(0.01, "1", "noise on next states, in deviations of steps", above=0)
    spread: float = setting(2.0, "1", "largest factor between truth and start", above=1)
    candidates: int = setting(32, "1", "candidates an iteration", least=4)
    iterations: int = setting(120, "1", "iterations a pass of the search, two passes", least=1)
    rows: int = setting(128, "1", "transitions that judge an iteration", least=1)
    units: int = setting(200, "1", "units in each of four layers", "authors' code", least=1)
    epochs: int = setting(300, "1", "passes over the data in training, at most", least=1)


def amounts(params: Params) -> list[int]:
    """Transitions to learn from; of the last, four times the full number, only networks."""
    return [params.data // 40, params.data // 10, params.data // 4, params.data, 4 * params.data]


def run(params: Params, pieces: Pieces) -> xr.Dataset:
    """Exact transitions over their number; noise and drag at the full number."""
    sizes = amounts(params)
    errors = np.full((len(DATA), len(MODELS), len(sizes), params.seeds, len(WHERE)), np.nan)
    shape = len(DATA), len(sizes), params.seeds, len(PSI)
    found = {name: np.full(shape, np.nan) for name in ("psi", "low", "high")}
    way = np.full((params.seeds, 2 * (params.iterations + 1), len(PSI)), np.nan)
    still, touched = np.empty((len(DATA), len(WHERE))), np.empty(len(DATA))
    flight = np.empty(len(PSI))
    for i, kind in enumerate(DATA):
        source = Source.of(kind, params, sizes[-1])
        still[i], touched[i] = source.still, source.touched.mean()
        if kind == DATA[0]:
            flight = pieces.get("flight", partial(in_flight, source))["high"]
        for j, n in enumerate(sizes):
            if kind != DATA[0] and n != params.data:
                continue
            for seed in range(params.seeds):
                key = f"{kind}-{n}-{seed}"
                make = partial(by_network, source, n, seed, params)
                errors[i, 1, j, seed] = pieces.get(f"network-{key}", make)["errors"]
                if n > params.data:
                    continue
                piece = pieces.get(f"psi-{key}", partial(by_psi, source, n, seed, params))
                errors[i, 0, j, seed] = piece["errors"]
                for name, values in found.items():
                    values[i, j, seed] = piece[name]
                if kind == DATA[0] and n == params.data:
                    way[seed, : len(piece["way"])] = piece["way"]
    found |= {"errors": errors, "still": still, "touched": touched, "way": way, "flight": flight}
    return xr.Dataset(_variables(found), {
        "data": list(DATA),
        "model": list(MODELS),
        "where": list(WHERE),
        "parameter": list(PSI),
        "transitions": quantity_of("transitions", sizes, "1", "transitions to learn from"),
        "iteration": quantity_of("iteration", np.arange(way.shape[1]), "1", "of the search"),
    })  # fmt: skip


def _variables(found: dict[str, np.ndarray]) -> dict[str, Any]:
    each = ("data", "transitions", "seed", "parameter")
    meant = {
        "errors": (("data", "model", "transitions", "seed", "where"), MIXED,
                   "mean one-step error, held out"),
        "still": (("data", "where"), MIXED, "mean one-step error if nothing moved"),
        "touched": (("data",), "1", "part of held-out transitions that end in contact"),
        "way": (("seed", "iteration", "parameter"), "1", "mean of the cloud over the truth"),
        "flight": (("parameter",), "1", "upper end at the truth, over it, where nothing touches"),
        "psi": (each, "1", "found over the truth"),
        "low": (each, "1", "interval, lower end over the truth"),
        "high": (each, "1", "interval, upper end over the truth"),
    }  # fmt: skip
    return {
        name: quantity_of(dims, found[name], unit, meaning)
        for name, (dims, unit, meaning) in meant.items()
    }
