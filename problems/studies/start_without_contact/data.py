"""N2: pushing and turning from a start without contact, through exact, smoothed, learned dynamics.

Pieces, each kept as soon as it is done: plans of input sequences by IPOPT under four contact laws;
gains learned by Adam through the five dynamics of the paper, over seeds; the same gains by IPOPT;
and what width of noise and how many data make of the learned ones.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import xarray as xr

from dynamics.contact import ContactLaw, Randomized
from dynamics.learned.transitions import Transitions
from problems.registry import get
from problems.studies.shared.learned_laws import transitions
from problems.studies.start_without_contact.dynamics import DYNAMICS, dynamics
from problems.studies.start_without_contact.learning import EVERY, by_ipopt, descend
from problems.studies.start_without_contact.open_loop import (
    PROBLEMS,
    labelled,
    object_cost,
    planned,
)
from problems.studies.study import CODE, Pieces, StudyParams, quantity_of, setting

SWEPT = ("g_sigma", "h_sigma")
WIDTHS = (0.05, 0.1, 0.2, 0.4)
LAST = 5
"""Records whose median is the final cost: with fresh noise the last alone is a draw."""


class Params(StudyParams):
    """Parameters of N2; those of the problems are the problems' own defaults."""

    mu: float = setting(1e-3, "N s m", "central-path parameter of the barrier law", CODE, above=0)
    spread: float = setting(0.02, "m", "width of the adaptive law", above=0)
    sigma: float = setting(0.1, "m or rad", "noise on the input, randomized law", above=0)
    samples: int = setting(8, "1", "samples of the randomized law, even", least=2)
    seeds: int = setting(5, "1", "seeds of data, networks and noise", least=1, most=50)
    data: int = setting(100_000, "1", "transitions", "paper", least=1000)
    width: float = setting(0.1, "1", "noise on the data, in their scales", above=0)
    draws: int = setting(100, "1", "draws of f_sigma a step, even", CODE, least=2)
    rate: float = setting(0.01, "1", "rate of Adam", above=0)
    steps: int = setting(500, "1", "iterations of Adam, tens", least=100)
    epochs: int = setting(20, "1", "passes over the data in training", least=1)


class _Source:
    """Transitions and laws of one problem, made when first asked for."""

    def __init__(self, name: str, params: Params) -> None:
        self.problem, self.params, self.name = get(name), params, name
        self._data: dict[tuple[int, int], Transitions] = {}

    def data(self, n: int, seed: int) -> Transitions:
        """n transitions of a seed."""
        if (n, seed) not in self._data:
            self._data = {(n, seed): transitions(self.name, n, seed)}
        return self._data[n, seed]

    def law(self, kind: str, sigma: float, n: int, seed: int) -> ContactLaw:
        """One of the five dynamics."""
        params, step = self.params, self.problem.exact_step
        data = self.data(n, seed)
        return dynamics(kind, data, sigma, params.epochs, seed, step, params.draws)


def run(params: Params, pieces: Pieces) -> xr.Dataset:
    """All pieces of the study, those that are kept not anew."""
    variables, coordinates = labelled(pieces.get("plans", lambda: planned(params)))
    sources = {name: _Source(name, params) for name in PROBLEMS}
    variables |= _learned(params, pieces, sources) | _swept(params, pieces, sources)
    coordinates |= {
        "dynamics": list(DYNAMICS),
        "swept": list(SWEPT),
        "width": ("width", list(WIDTHS), {"units": "1"}),
        "amount": ("amount", _amounts(params), {"units": "1"}),
        "step": ("step", EVERY * np.arange(params.steps // EVERY + 1), {"units": "1"}),
        "end": ["model", "exact replay"],
    }
    return xr.Dataset(variables, coordinates)


def _amounts(params: Params) -> list[int]:
    return [max(1000, params.data // 100), max(1000, params.data // 10), params.data]


def _learned(params: Params, pieces: Pieces, sources: dict[str, _Source]) -> dict[str, Any]:
    """Adam's costs over iterations and seeds, the object's in the end, and IPOPT's gains."""
    records, nodes = params.steps // EVERY + 1, 21
    shape = len(PROBLEMS), len(DYNAMICS)
    learned = np.full((*shape, params.seeds, records, 2), np.nan)
    states = np.full((*shape, nodes, 7), np.nan)
    of_object = np.full((*shape, params.seeds), np.nan)
    gains, work = np.full((*shape, 2), np.nan), np.zeros(shape, dtype=int)
    for row, (name, source) in enumerate(sources.items()):
        for column, kind in enumerate(DYNAMICS):
            for seed in range(params.seeds):
                # f has no data and no noise: every seed is the first.
                at = params.seed + (seed if kind != "f" else 0)
                found = _descent(pieces, source, kind, params.width, params.data, at)
                learned[row, column, seed] = np.stack([found["model"], found["exact"]], axis=1)
                of_object[row, column, seed] = object_cost(name, found["states"])
                if seed == 0:
                    states[row, column, :, : source.problem.system.nx] = found["states"]
            found = pieces.get(f"ipopt-{name}-{kind}", _ipopt(source, kind))
            gains[row, column], work[row, column] = found["costs"], found["iterations"]
    both = ("problem", "dynamics")
    return {
        "learned": quantity_of((*both, "seed", "step", "end"), learned, "1", "cost, eq. 14"),
        "object": quantity_of((*both, "seed"), of_object, "1", "object's cost, exact replay"),
        "states": quantity_of((*both, "node", "entry"), states, "m, rad", "exact replay"),
        "gains": quantity_of((*both, "end"), gains, "1", "cost of IPOPT's gains"),
        "work": quantity_of(both, work, "1", "iterations of IPOPT"),
    }


def _descent(
    pieces: Pieces, source: _Source, kind: str, sigma: float, n: int, seed: int
) -> dict[str, np.ndarray]:
    params = source.params

    def make() -> dict[str, np.ndarray]:
        law = source.law(kind, sigma, n, seed)
        return descend(source.problem, law, params.rate, params.steps)

    return pieces.get(f"adam-{source.name}-{kind}-{sigma:g}-{n}-{seed}", make)


def _ipopt(source: _Source, kind: str) -> Callable[[], dict[str, np.ndarray]]:
    params = source.params

    def make() -> dict[str, np.ndarray]:
        if kind == "f_sigma":
            law: ContactLaw = Randomized(params.sigma, params.samples, params.seed)
        else:
            law = source.law(kind, params.width, params.data, params.seed)
        return by_ipopt(source.problem, law)

    return make


def _swept(params: Params, pieces: Pieces, sources: dict[str, _Source]) -> dict[str, Any]:
    """Final exact cost of the learned dynamics over width of noise and amount of data."""
    amounts = _amounts(params)
    final = np.full((len(PROBLEMS), len(SWEPT), len(WIDTHS), len(amounts)), np.nan)
    for row, source in enumerate(sources.values()):
        for column, kind in enumerate(SWEPT):
            for j, n in enumerate(amounts):
                for i, sigma in enumerate(WIDTHS):
                    found = _descent(pieces, source, kind, sigma, n, params.seed)
                    final[row, column, i, j] = np.median(found["exact"][-LAST:])
    dims = ("problem", "swept", "width", "amount")
    return {"final": quantity_of(dims, final, "1", "final cost under the exact law")}
