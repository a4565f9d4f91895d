"""C1: closed loops of every controller on every plant of every task.

The study has one part for each task, controller and plant, which is stored when it is finished: the
costs of all seeds, which runs diverged, and the computing time of a sample.
"""

from __future__ import annotations

import warnings
from functools import cache

import casadi as ca
import numpy as np
import xarray as xr

from dynamics.batch import BatchWarning
from dynamics.contact import Adaptive, Barrier, ContactLaw, Exact, Randomized
from ocp.judge.step_size import step_size_kind
from ocp.mpc import ClosedLoop, Controller, Disturbance, simulate
from ocp.problem.problem import Problem
from problems.registry import get
from problems.studies.progress import track_items
from problems.studies.study import FinishedParts, StudyParams, dataset, setting

TASKS = {
    "push-disc": "M",
    "soft-walls": "k",
    "planar-push": "m",
    "cart-walls": "mp",
    "finger-disc": "m",
    "spinner": "m",
}
"""Mapping from each task to the parameter that the plant ``mismatch`` changes."""
PLANTS = ("model", "referee", "h/4", "mismatch", "noise")
"""Names of the plants that are controlled."""
LAWS: dict[str, ContactLaw] = {
    "exact": Exact(),
    **{f"barrier {mu:g}": Barrier(mu=mu) for mu in (1e-1, 1e-2, 1e-3)},
    "adaptive": Adaptive(),
    "randomized": Randomized(),
}
"""Mapping from names to the contact laws of plans; mu in N s m, the last two laws at their default settings."""
FOLLOWED = ("exact", "barrier 0.01")
"""Names of the laws whose plan is followed by gains or by its inputs."""
FEEDBACK = tuple(f"gains, {law}" for law in FOLLOWED)
"""Names of the controllers that follow one plan by linear feedback."""
INPUTS = tuple(f"inputs, {law}" for law in FOLLOWED)
"""Names of the controllers that apply the inputs of one plan without feedback."""
CONTROLLERS = (*LAWS, *FEEDBACK, *INPUTS)
"""Names of all controllers, in the order of the data."""
QUICK = {"tasks": 1, "seeds": 2}
_MISMATCH_FACTOR = 1.3
"""Factor by which the plant ``mismatch`` multiplies its parameter in :data:`TASKS`."""
_RUN_HORIZONS = 2
"""Length of a run, as a multiple of the problem's horizon."""
_LARGEST_RATIO = 1000.0
"""Upper limit of the ratio of a cost to the lowest cost; runs with the cost NaN get this value."""
_SURVIVAL_RATIO = 2.0
"""Maximum ratio of the cost of a run that survives to the lowest cost on the model from the same seed."""


class Params(StudyParams):
    """Parameters of study C1; problems and laws have their defaults."""

    tasks: int = setting(len(TASKS), "1", "the first of the tasks", least=1, most=len(TASKS))
    seeds: int = setting(20, "1", "seeds of starts and noise", least=2, most=200)
    spread: float = setting(0.05, "1", "of starts, in characteristic sizes", least=0, most=0.2)


class TaskLoops:
    """Closed loops of one task; each controller is built at its first use."""

    def __init__(self, name: str, params: Params) -> None:
        self.name, self.params, self.problem = name, params, get(name)
        self.starts = initial_states(self.problem, params)
        self.controller = cache(self._controller)

    def _controller(self, name: str) -> Controller:
        kind, _, law = name.rpartition(", ")
        if kind == "inputs":
            u = self.controller(f"gains, {law}").current_plan.u
            return Controller(self.problem, phase="policy", policy=lambda _, k: u[min(k, len(u) - 1)])
        phase = "policy" if kind else "qpcc" if law == "exact" else "relaxed"
        return Controller(self.problem, contact=LAWS[law], phase=phase)

    @property
    def plants(self) -> list[str]:
        """Names of the plants for this task, with ``referee`` and ``h/4`` only if they differ from the model."""
        alike = {
            "referee": self.problem.referee_step is self.problem.exact_step,
            "h/4": step_size_kind(self.problem.system).kind == "fixed",
        }
        return [plant for plant in PLANTS if not alike.get(plant)]

    def loop(self, name: str, plant: str) -> dict[str, np.ndarray]:
        """Simulate the controller ``name`` on ``plant`` for all seeds; return a mapping from names to arrays.

        ``cost`` (seeds, 2) has the costs of the first horizon and of the whole run, ``ended`` (seeds,) is
        True for diverged runs, and ``ms`` is the 99th percentile of the computing time of a sample [ms].
        """
        parameter, N = TASKS[self.name], self.problem.N
        larger = {parameter: _MISMATCH_FACTOR * self.problem.parameters.defaults[parameter]}
        disturbance = Disturbance(mismatch=larger if plant == "mismatch" else {})
        physics = plant if plant in ("referee", "h/4", "noise") else "exact"
        with warnings.catch_warnings():
            # Candidate steps of a plan may diverge; the planner then takes another step.
            warnings.simplefilter("ignore", BatchWarning)
            closed_loop = simulate(
                self.controller(name),
                _RUN_HORIZONS * N,
                physics,
                disturbance,
                seeds=self.params.seeds,
                seed=self.params.seed,
                x0=self.starts,
            )
        costs = np.stack([cost_at(closed_loop, N), closed_loop.costs], axis=1)
        return {"cost": costs, "ended": ~closed_loop.survived, "ms": np.array(1e3 * closed_loop.percentile(99))}


def initial_states(problem: Problem, params: Params) -> np.ndarray:
    """Return initial states (seeds, nx) without penetration: the problem's start, then random states around it."""
    p, system = problem.parameters.values, problem.system
    nominal = np.array(problem.limits(p)[0]).ravel()
    phi = ca.SX(0) if system.phi is None else system.phi
    distances = ca.Function("distances", [system.x, problem.parameters.vector], [phi])
    rng, states = np.random.default_rng(params.seed), [nominal]
    while len(states) < params.seeds:
        x = nominal + params.spread * problem.scales.x * rng.standard_normal(nominal.size)
        if np.all(np.array(distances(x, p)) >= 0):
            states.append(x)
    return np.array(states)


def cost_at(closed_loop: ClosedLoop, N: int) -> np.ndarray:
    """Return the costs (seeds,) of the first ``N`` samples, including the terminal cost of the state after them."""
    x, u, stage_costs = (closed_loop.data[name].values for name in ("x", "u", "cost"))
    problem, last = closed_loop.problem, u[:, N - 1]
    terms, p = problem.cost_terms, problem.parameters.values
    lam = np.zeros(problem.system.nlam)
    ends = [float(terms(*point, 0 * point[1], lam, p)[1]) for point in zip(x[:, N], last, strict=True)]
    return stage_costs[:, :N].sum(axis=1) + ends


def run(params: Params, finished: FinishedParts) -> xr.Dataset:
    """Run every controller on every plant of every task; finished parts are loaded."""
    names = list(TASKS)[: params.tasks]
    shape = len(names), len(PLANTS), len(CONTROLLERS)
    costs = np.full((*shape, params.seeds, 2), np.nan)
    diverged, ms = np.full((*shape, params.seeds), np.nan), np.full(shape, np.nan)
    sources = [TaskLoops(name, params) for name in names]
    for i, j in track_items("tasks and controllers", list(np.ndindex(shape[0], shape[2]))):
        source, name = sources[i], CONTROLLERS[j]
        for plant in source.plants:
            key = f"{names[i]}-{name}-{plant}".replace(", ", "-").replace(" ", "-").replace("/", "")
            loop = finished.get(key, lambda s=source, n=name, p=plant: s.loop(n, p))
            index = i, PLANTS.index(plant), j
            costs[index], diverged[index], ms[index] = loop["cost"], loop["ended"], loop["ms"]
    dims = ("task", "plant", "controller")
    return dataset(
        {
            "cost": ((*dims, "seed", "span"), costs, "1", "closed-loop cost"),
            "ended": ((*dims, "seed"), diverged, "1", "whether the plant diverged, 1 or 0"),
            "ms": (dims, ms, "ms", "time of a sample, percentile 99"),
        },
        {
            "task": names,
            "plant": list(PLANTS),
            "controller": list(CONTROLLERS),
            "seed": (params.seed + np.arange(params.seeds), "1"),
            "span": ["first horizon", "run"],
        },
    )


def relative_cost(data: xr.Dataset) -> xr.DataArray:
    """Return ratios of costs to the lowest cost on the same task, plant and seed; NaN for loops that were not run."""
    ratio = data["cost"] / data["cost"].min("controller")
    return ratio.fillna(_LARGEST_RATIO).clip(max=_LARGEST_RATIO).where(data["ended"].notnull())


def survival(data: xr.Dataset) -> xr.DataArray:
    """Return 1 for costs of at most twice the same seed's lowest cost on the model, else 0; NaN if not run."""
    best = data["cost"].sel(plant="model", drop=True).min("controller")
    return (data["cost"] <= _SURVIVAL_RATIO * best).astype(float).where(data["ended"].notnull())


def run_settings(data: xr.Dataset) -> list[tuple[str, str]]:
    """Return the pairs (task, plant) that were run."""
    ran = data["ended"].notnull().all(["controller", "seed"]).values
    tasks, plants = data["task"].values, data["plant"].values
    return [(str(tasks[i]), str(plants[j])) for i, j in np.argwhere(ran)]
