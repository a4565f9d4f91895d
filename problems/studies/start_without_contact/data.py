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

from dynamics.contact import Adaptive, Barrier, ContactLaw, Exact, Randomized
from dynamics.learned.transitions import Transitions
from ocp import SingleShooting, Solution, solve
from ocp.problem.problem import Problem
from problems.registry import get
from problems.studies.progress import tracked
from problems.studies.shared.learned_laws import transitions
from problems.studies.start_without_contact.dynamics import (
    DYNAMICS,
    EVERY,
    by_ipopt,
    descend,
    dynamics,
)
from problems.studies.study import CODE, Pieces, StudyParams, dataset, setting

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


class _TaskData:
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


QUICK = {"seeds": 1, "data": 1000, "draws": 10, "steps": 100, "epochs": 1}


def run(params: Params, pieces: Pieces) -> xr.Dataset:
    """All pieces of the study, those that are kept not anew."""
    variables, coordinates = labelled(pieces.get("plans", lambda: planned(params)))
    sources = {name: _TaskData(name, params) for name in PROBLEMS}
    variables |= _learned(params, pieces, sources) | _swept(params, pieces, sources)
    coordinates |= {
        "dynamics": list(DYNAMICS),
        "swept": list(SWEPT),
        "width": (list(WIDTHS), "1"),
        "amount": (_amounts(params), "1"),
        "step": (EVERY * np.arange(params.steps // EVERY + 1), "1"),
        "end": ["model", "exact replay"],
    }
    return dataset(variables, coordinates)


def _amounts(params: Params) -> list[int]:
    return [max(1000, params.data // 100), max(1000, params.data // 10), params.data]


def _learned(params: Params, pieces: Pieces, sources: dict[str, _TaskData]) -> dict[str, Any]:
    """Adam's costs over iterations and seeds, the object's in the end, and IPOPT's gains."""
    records, nodes = params.steps // EVERY + 1, 21
    shape = len(PROBLEMS), len(DYNAMICS)
    learned = np.full((*shape, params.seeds, records, 2), np.nan)
    states = np.full((*shape, nodes, 7), np.nan)
    of_object = np.full((*shape, params.seeds), np.nan)
    gains, work = np.full((*shape, 2), np.nan), np.zeros(shape, dtype=int)
    named = list(sources.items())
    for row, column in tracked("problems and dynamics", list(np.ndindex(shape))):
        (name, source), kind = named[row], DYNAMICS[column]
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
        "learned": ((*both, "seed", "step", "end"), learned, "1", "cost, eq. 14"),
        "object": ((*both, "seed"), of_object, "1", "object's cost, exact replay"),
        "states": ((*both, "node", "entry"), states, "m, rad", "exact replay"),
        "gains": ((*both, "end"), gains, "1", "cost of IPOPT's gains"),
        "work": (both, work, "1", "iterations of IPOPT"),
    }


def _descent(pieces: Pieces, source: _TaskData, kind: str, sigma: float, n: int, seed: int) -> dict[str, np.ndarray]:
    params = source.params

    def make() -> dict[str, np.ndarray]:
        law = source.law(kind, sigma, n, seed)
        return descend(source.problem, law, params.rate, params.steps)

    return pieces.get(f"adam-{source.name}-{kind}-{sigma:g}-{n}-{seed}", make)


def _ipopt(source: _TaskData, kind: str) -> Callable[[], dict[str, np.ndarray]]:
    params = source.params

    def make() -> dict[str, np.ndarray]:
        if kind == "f_sigma":
            law: ContactLaw = Randomized(params.sigma, params.samples, params.seed)
        else:
            law = source.law(kind, params.width, params.data, params.seed)
        return by_ipopt(source.problem, law)

    return make


def _swept(params: Params, pieces: Pieces, sources: dict[str, _TaskData]) -> dict[str, Any]:
    """Final exact cost of the learned dynamics over width of noise and amount of data."""
    amounts = _amounts(params)
    final = np.full((len(PROBLEMS), len(SWEPT), len(WIDTHS), len(amounts)), np.nan)
    listed = list(sources.values())
    for row, column, i, j in tracked("widths and amounts", list(np.ndindex(final.shape))):
        kind, sigma, n = SWEPT[column], WIDTHS[i], amounts[j]
        found = _descent(pieces, listed[row], kind, sigma, n, params.seed)
        final[row, column, i, j] = np.median(found["exact"][-LAST:])
    dims = ("problem", "swept", "width", "amount")
    return {"final": (dims, final, "1", "final cost under the exact law")}


PROBLEMS = ("planar-push", "planar-hand")
LAWS = ("exact", "barrier", "adaptive", "randomized")
_NODES = 21
"""Nodes of a plan, which all have: twenty steps."""


def law_of(name: str, params: Params) -> ContactLaw:
    """Return the contact law called ``name`` at the study's settings."""
    laws: dict[str, ContactLaw] = {
        "exact": Exact(),
        "barrier": Barrier(mu=params.mu),
        "adaptive": Adaptive(sigma=params.spread),
        "randomized": Randomized(params.sigma, params.samples, params.seed),
    }
    return laws[name]


def plan(problem: Problem, law: ContactLaw) -> Solution:
    """Plan by single shooting from the problem's guess, where everything stands still.

    The exact law is given no homotopy, which would begin under another law.
    """
    settings = {"homotopy": False} if isinstance(law, Exact) else {}
    return solve(problem, law, SingleShooting(), settings=settings)


def object_cost(name: str, x: np.ndarray) -> float:
    """Part of the cost that looks at the object, of states x (N+1, nx); the rest weighs nothing."""
    problem = get(name, w_a=0.0, w_du=0.0)
    p, still = problem.parameters.values, np.zeros(problem.system.nu)
    stages = [problem.cost_terms(state, still, still, 0, p) for state in x]
    return sum(float(stage) for stage, _ in stages[:-1]) + float(stages[-1][1])


def gains(name: str, found: Solution) -> tuple[float, float, float]:
    """Object's cost: standing still, as planned, and as replayed under the exact law."""
    planned, replay = found.data["x"].values[0], found.data["x_replay"].values[0]
    start = np.broadcast_to(planned[0], planned.shape)
    return object_cost(name, start), object_cost(name, planned), object_cost(name, replay)


def planned(params: Params) -> dict[str, Any]:
    """Plan both problems under every law; object's cost of plan and replay, and the paths."""
    shape = (len(PROBLEMS), len(LAWS))
    total = np.empty((*shape, 2))
    cost, moved = np.empty((*shape, 3)), np.empty(shape, dtype=int)
    path = np.empty((*shape, 2, _NODES, 3))
    status = np.empty(shape, dtype="<U16")
    for row, name in enumerate(PROBLEMS):
        for column, law in enumerate(LAWS):
            found = plan(get(name), law_of(law, params))
            cost[row, column] = gains(name, found)
            total[row, column] = found.cost, found.audit.exact_cost
            status[row, column] = found.status.label
            moved[row, column] = found.iterations
            for i, kind in enumerate(("x", "x_replay")):
                path[row, column, i] = found.data[kind].values[0][:, :3]
    return {"cost": cost, "total": total, "iterations": moved, "status": status, "path": path}


def labelled(found: dict[str, np.ndarray]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Variables and coordinates of a dataset from :func:`planned`."""
    both = ("problem", "law")
    return {
        "cost": ((*both, "of"), found["cost"], "1", "cost of the object"),
        "total": ((*both, "motion"), found["total"], "1", "whole cost"),
        "iterations": (both, found["iterations"], "1", "iterations of the solver"),
        "status": (both, found["status"]),
        "path": ((*both, "motion", "node", "pose"), found["path"], "m, m, rad", "pose of the object"),
    }, {
        "problem": list(PROBLEMS),
        "law": list(LAWS),
        "of": ["at rest", "plan", "exact replay"],
        "motion": ["plan", "exact replay"],
        "pose": ["x", "y", "angle"],
    }
