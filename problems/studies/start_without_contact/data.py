"""N2: pushing and turning from a start without contact, through exact, smoothed and learned dynamics.

The study has these parts, each stored when it is finished: plans of inputs by IPOPT under four contact
laws; feedback gains learned by Adam through the five dynamics of the paper, for several seeds; gains
computed by IPOPT; and gains through learned dynamics for several widths of noise and amounts of data.
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
from problems.studies.progress import track_items
from problems.studies.shared.learned_laws import draw_transitions
from problems.studies.start_without_contact.dynamics import DYNAMICS, EVERY, by_ipopt, descend_gains, make_law
from problems.studies.study import CODE, FinishedParts, StudyParams, dataset, setting

SWEPT = ("g_sigma", "h_sigma")
"""Names of the learned dynamics for which noise width and amount of data are varied."""
WIDTHS = (0.05, 0.1, 0.2, 0.4)
"""Widths of the noise on the data, in units of the data's scales."""
LAST = 5
"""Number of last records whose median is the final cost, since each record is random due to new noise."""


class Params(StudyParams):
    """Parameters of study N2; its problems have their defaults."""

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
    """Source of transitions and contact laws of one problem; it stores the last transitions drawn."""

    def __init__(self, name: str, params: Params) -> None:
        self.problem, self.params, self.name = get(name), params, name
        self._data: dict[tuple[int, int], Transitions] = {}

    def data(self, n: int, seed: int) -> Transitions:
        """Return n transitions drawn with ``seed``."""
        if (n, seed) not in self._data:
            self._data = {(n, seed): draw_transitions(self.name, n, seed)}
        return self._data[n, seed]

    def law(self, kind: str, sigma: float, n: int, seed: int) -> ContactLaw:
        """Return the law of the dynamics ``kind``; a learned law is fitted to n transitions with noise ``sigma``."""
        params, step = self.params, self.problem.exact_step
        data = self.data(n, seed)
        return make_law(kind, data, sigma, params.epochs, seed, step, params.draws)


QUICK = {"seeds": 1, "data": 1000, "draws": 10, "steps": 100, "epochs": 1}


def run(params: Params, finished: FinishedParts) -> xr.Dataset:
    """Compute plans and gains of both problems through all dynamics; finished parts are loaded."""
    variables, coordinates = label_plans(finished.get("plans", lambda: plan_problems(params)))
    sources = {name: _TaskData(name, params) for name in PROBLEMS}
    variables |= _learned(params, finished, sources) | _swept(params, finished, sources)
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


def _learned(params: Params, finished: FinishedParts, sources: dict[str, _TaskData]) -> dict[str, Any]:
    """Collect costs of Adam's gains over iterations and seeds, the object's final cost, and results of IPOPT."""
    records, nodes = params.steps // EVERY + 1, 21
    shape = len(PROBLEMS), len(DYNAMICS)
    learned = np.full((*shape, params.seeds, records, 2), np.nan)
    states = np.full((*shape, nodes, 7), np.nan)
    of_object = np.full((*shape, params.seeds), np.nan)
    gains, work = np.full((*shape, 2), np.nan), np.zeros(shape, dtype=int)
    named = list(sources.items())
    for row, column in track_items("problems and dynamics", list(np.ndindex(shape))):
        (name, source), kind = named[row], DYNAMICS[column]
        for seed in range(params.seeds):
            # f has no data and no noise, so that every seed gives the same result.
            run_seed = params.seed + (seed if kind != "f" else 0)
            descent = _descent(finished, source, kind, params.width, params.data, run_seed)
            learned[row, column, seed] = np.stack([descent["model"], descent["exact"]], axis=1)
            of_object[row, column, seed] = object_cost(name, descent["states"])
            if seed == 0:
                states[row, column, :, : source.problem.system.nx] = descent["states"]
        descent = finished.get(f"ipopt-{name}-{kind}", _ipopt(source, kind))
        gains[row, column], work[row, column] = descent["costs"], descent["iterations"]
    dimensions = ("problem", "dynamics")
    return {
        "learned": ((*dimensions, "seed", "step", "end"), learned, "1", "cost, eq. 14"),
        "object": ((*dimensions, "seed"), of_object, "1", "object's cost, exact replay"),
        "states": ((*dimensions, "node", "entry"), states, "m, rad", "exact replay"),
        "gains": ((*dimensions, "end"), gains, "1", "cost of IPOPT's gains"),
        "work": (dimensions, work, "1", "iterations of IPOPT"),
    }


def _descent(
    finished: FinishedParts, source: _TaskData, kind: str, sigma: float, n: int, seed: int
) -> dict[str, np.ndarray]:
    params = source.params

    def make() -> dict[str, np.ndarray]:
        law = source.law(kind, sigma, n, seed)
        return descend_gains(source.problem, law, params.rate, params.steps)

    return finished.get(f"adam-{source.name}-{kind}-{sigma:g}-{n}-{seed}", make)


def _ipopt(source: _TaskData, kind: str) -> Callable[[], dict[str, np.ndarray]]:
    params = source.params

    def make() -> dict[str, np.ndarray]:
        if kind == "f_sigma":
            law: ContactLaw = Randomized(params.sigma, params.samples, params.seed)
        else:
            law = source.law(kind, params.width, params.data, params.seed)
        return by_ipopt(source.problem, law)

    return make


def _swept(params: Params, finished: FinishedParts, sources: dict[str, _TaskData]) -> dict[str, Any]:
    """Collect final exact costs of gains from learned dynamics, over noise width and amount of data."""
    amounts = _amounts(params)
    final = np.full((len(PROBLEMS), len(SWEPT), len(WIDTHS), len(amounts)), np.nan)
    task_data = list(sources.values())
    for row, column, i, j in track_items("widths and amounts", list(np.ndindex(final.shape))):
        kind, sigma, n = SWEPT[column], WIDTHS[i], amounts[j]
        descent = _descent(finished, task_data[row], kind, sigma, n, params.seed)
        final[row, column, i, j] = np.median(descent["exact"][-LAST:])
    dims = ("problem", "swept", "width", "amount")
    return {"final": (dims, final, "1", "final cost under the exact law")}


PROBLEMS = ("planar-push", "planar-hand")
"""Names of the problems for which plans and gains are computed."""
LAWS = ("exact", "barrier", "adaptive", "randomized")
"""Names of the contact laws under which plans are made."""
_PLAN_NODES = 21
"""Number of nodes of every plan (twenty steps)."""


def law_of(name: str, params: Params) -> ContactLaw:
    """Return the contact law called ``name`` at the study's settings."""
    laws: dict[str, ContactLaw] = {
        "exact": Exact(),
        "barrier": Barrier(mu=params.mu),
        "adaptive": Adaptive(sigma=params.spread),
        "randomized": Randomized(params.sigma, params.samples, params.seed),
    }
    return laws[name]


def plan_problem(problem: Problem, law: ContactLaw) -> Solution:
    """Plan by single shooting from the problem's guess, which stands still.

    The exact law is solved without a homotopy, which would start under another law.
    """
    settings = {"homotopy": False} if isinstance(law, Exact) else {}
    return solve(problem, law, SingleShooting(), settings=settings)


def object_cost(name: str, x: np.ndarray) -> float:
    """Return the cost of states x (N+1, nx) due to the object, without the actuator's terms."""
    problem = get(name, w_a=0.0, w_du=0.0)
    p, no_input = problem.parameters.values, np.zeros(problem.system.nu)
    stages = [problem.cost_terms(state, no_input, no_input, 0, p) for state in x]
    return sum(float(stage) for stage, _ in stages[:-1]) + float(stages[-1][1])


def object_costs(name: str, solution: Solution) -> tuple[float, float, float]:
    """Return the object's part of three costs: standing still, the plan, and its replay under the exact law."""
    planned, replay = solution.data["x"].values[0], solution.data["x_replay"].values[0]
    start = np.broadcast_to(planned[0], planned.shape)
    return object_cost(name, start), object_cost(name, planned), object_cost(name, replay)


def plan_problems(params: Params) -> dict[str, Any]:
    """Plan both problems under every law; return costs, iterations, status and paths as arrays."""
    shape = (len(PROBLEMS), len(LAWS))
    total = np.empty((*shape, 2))
    cost, iterations = np.empty((*shape, 3)), np.empty(shape, dtype=int)
    path = np.empty((*shape, 2, _PLAN_NODES, 3))
    status = np.empty(shape, dtype="<U16")
    for row, name in enumerate(PROBLEMS):
        for column, law in enumerate(LAWS):
            solution = plan_problem(get(name), law_of(law, params))
            cost[row, column] = object_costs(name, solution)
            total[row, column] = solution.cost, solution.audit.exact_cost
            status[row, column] = solution.status.label
            iterations[row, column] = solution.iterations
            for i, kind in enumerate(("x", "x_replay")):
                path[row, column, i] = solution.data[kind].values[0][:, :3]
    return {"cost": cost, "total": total, "iterations": iterations, "status": status, "path": path}


def label_plans(plans: dict[str, np.ndarray]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return variables and coordinates of a dataset made from ``plans``, the result of :func:`plan_problems`."""
    dimensions = ("problem", "law")
    return {
        "cost": ((*dimensions, "of"), plans["cost"], "1", "cost of the object"),
        "total": ((*dimensions, "motion"), plans["total"], "1", "whole cost"),
        "iterations": (dimensions, plans["iterations"], "1", "iterations of the solver"),
        "status": (dimensions, plans["status"]),
        "path": ((*dimensions, "motion", "node", "pose"), plans["path"], "m, m, rad", "pose of the object"),
    }, {
        "problem": list(PROBLEMS),
        "law": list(LAWS),
        "of": ["at rest", "plan", "exact replay"],
        "motion": ["plan", "exact replay"],
        "pose": ["x", "y", "angle"],
    }
