"""N3: plans under every contact law, and their costs under the exact law.

The study has one part for each problem, law and seed, which is stored when it is finished: the costs
of plan and replay, whether the plan survives the referee, the number of iterations, and the times of
learning and solving [s].
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any

import numpy as np
import xarray as xr

from dynamics.contact import Adaptive, Barrier, ContactLaw, Exact, Randomized
from dynamics.learned.transitions import Transitions
from ocp import Direct, Solution, solve
from ocp.problem.rollout import roll_out
from problems.registry import get
from problems.studies.progress import track_items
from problems.studies.shared.learned_laws import average_law, draw_transitions, network_law
from problems.studies.study import FinishedParts, StudyParams, dataset, setting

PROBLEMS = ("push-1d", "push-disc", "planar-push", "planar-hand")
"""Names of the problems for which plans are computed."""
QUICK = {"seeds": 1, "data": 1000, "epochs": 1, "samples": 2}
SHARES = (0.001, 0.01, 0.1, 1.0)
"""Weights of the data's log-density in the cost (trust), relative to the cost of one step of standing still."""
TRUSTED = 0.001
"""Weight of trust in the law ``trusting ewda``, the weight for which replays cost least."""


class Params(StudyParams):
    """Parameters of study N3; problems have their defaults."""

    mu: float = setting(1e-3, "N s m", "central-path parameter of the barrier law", above=0)
    spread: float = setting(0.02, "m", "width of the adaptive law", above=0)
    sigma: float = setting(0.1, "m or rad", "noise on the input, randomized law", above=0)
    samples: int = setting(8, "1", "samples of the randomized law, even", least=2)
    data: int = setting(100_000, "1", "transitions", "paper", least=1000)
    width: float = setting(0.1, "1", "noise on the data, in their scales", above=0)
    wide: float = setting(0.2, "1", "wider noise on the data, in their scales", above=0)
    epochs: int = setting(15, "1", "passes over the data in training", least=1)
    batch: int = setting(512, "1", "transitions a step of training", least=1)
    seeds: int = setting(3, "1", "seeds of data, networks and noise", least=1, most=50)


class TaskData:
    """Source of transitions, laws and plans of one problem and seed."""

    def __init__(self, name: str, seed: int, params: Params) -> None:
        self.name, self.seed, self.params, self.problem = name, seed, params, get(name)
        self._data: Transitions | None = None
        self._bare: Solution | None = None

    @property
    def data(self) -> Transitions:
        """Transitions of the problem, drawn at first use."""
        if self._data is None:
            self._data = draw_transitions(self.name, self.params.data, self.seed)
        return self._data

    def law(self, name: str) -> ContactLaw:
        """Return the contact law ``name``; for ``trusting ewda`` see :meth:`trusting`."""
        params, seed = self.params, self.seed
        makers: dict[str, Callable[[], ContactLaw]] = {
            "exact": Exact,
            "gentle barrier": lambda: Barrier(mu=params.mu * TENFOLD),
            "barrier": lambda: Barrier(mu=params.mu),
            "sharp barrier": lambda: Barrier(mu=params.mu / TENFOLD),
            "adaptive": lambda: Adaptive(sigma=params.spread),
            "randomized": lambda: Randomized(params.sigma, params.samples, seed),
            "ewda": lambda: average_law(self.data, params.width, seed),
            "wide ewda": lambda: average_law(self.data, params.wide, seed),
            "clean mlp": lambda: self._network(0.0),
            "noised mlp": lambda: self._network(params.width),
        }
        return makers[name]()

    def _network(self, sigma: float) -> ContactLaw:
        params = self.params
        return network_law(self.data, sigma, self.seed, params.epochs, params.batch)

    def planned(self, name: str) -> dict[str, np.ndarray]:
        """Plan under the law ``name`` from the problem's guess; return costs, survival, iterations and times."""
        _loaded()
        self._data = None
        began_s = time.process_time()
        law = self.law(name)
        learned_s = time.process_time()
        solution = solve(self.problem, law, Direct())
        if name == "ewda":
            self._bare = solution
        return _plan_row(solution, learned_s - began_s, time.process_time() - learned_s)

    def trusting(self, share: float) -> dict[str, np.ndarray]:
        """Plan with trust of weight ``share``, warm-started from the plan without trust; return as :meth:`planned`."""
        _loaded()
        if self._bare is None:
            self._bare = solve(self.problem, self.law("ewda"), Direct())
        untrusting = self._bare
        beta = share * rest_cost(self.name) / self.problem.N
        law = average_law(self.data, self.params.width, self.seed, beta)
        began_s = time.process_time()
        solution = solve(self.problem, law, Direct(), warm_start=untrusting)
        return _plan_row(solution, 0.0, time.process_time() - began_s)


def rest_cost(name: str) -> float:
    """Return the cost of standing still under the exact law."""
    problem = get(name)
    inputs = np.array(problem.limits(problem.parameters.values)[1]).ravel()
    return roll_out(problem, np.tile(inputs, (1, problem.N, 1)), problem.parameters.defaults).cost


def run(params: Params, finished: FinishedParts) -> xr.Dataset:
    """Plan under every law and with every weight of trust; finished parts are loaded."""
    shape, shares = (len(PROBLEMS), len(LAWS), params.seeds), (0.0, *SHARES)
    rows = np.full((*shape, 6), np.nan)
    trust_rows = np.full((len(PROBLEMS), len(shares), params.seeds, 6), np.nan)
    for i, k in track_items("problems and seeds", list(np.ndindex(len(PROBLEMS), params.seeds))):
        name, seed = PROBLEMS[i], params.seed + k
        source = TaskData(name, seed, params)
        for j, law in enumerate(LAWS):
            if law == "trusting ewda":
                continue
            data_seed = seed if law in DRAWN else params.seed
            key = f"{name}-{law.replace(' ', '-')}-{data_seed}"
            rows[i, j, k] = finished.get(key, lambda s=source, w=law: s.planned(w))["told"]
        trust_rows[i, 0, k] = rows[i, LAWS.index("ewda"), k]
        for j, share in enumerate(SHARES, 1):
            key = f"{name}-trust-{share:g}-{seed}"
            trust_rows[i, j, k] = finished.get(key, lambda s=source, b=share: s.trusting(b))["told"]
        trusted_row = trust_rows[i, shares.index(TRUSTED), k].copy()
        trusted_row[-2:] += trust_rows[i, 0, k, -2:]
        rows[i, LAWS.index("trusting ewda"), k] = trusted_row
    return dataset(
        {
            **_labelled(("problem", "law", "seed"), rows, ""),
            **_labelled(("problem", "share", "seed"), trust_rows, "trusting_"),
            "rest": (
                "problem",
                [rest_cost(name) for name in PROBLEMS],
                "1",
                "cost of standing still under the exact law",
            ),
        },
        {
            "problem": list(PROBLEMS),
            "law": list(LAWS),
            "seed": (params.seed + np.arange(params.seeds), "1"),
            "share": (list(shares), "1"),
            "motion": ["plan", "exact replay"],
            "part": ["learning", "solving"],
        },
    )


def _labelled(dims: tuple[str, ...], rows: np.ndarray, prefix: str) -> dict[str, Any]:
    """Return dataset variables, with ``prefix`` before their names, from rows of :func:`_plan_row`."""
    columns = {
        "cost": ((*dims, "motion"), rows[..., :2], "1", "cost of the plan and of its replay"),
        "survives": (dims, rows[..., 2], "1", "whether the referee lets the plan survive, 1 or 0"),
        "iterations": (dims, rows[..., 3], "1", "iterations of the solver"),
        "seconds": ((*dims, "part"), rows[..., 4:], "s", "time of the processor"),
    }
    return {prefix + name: column for name, column in columns.items()}


def _plan_row(solution: Solution, learning: float, solving: float) -> dict[str, np.ndarray]:
    costs = solution.cost, solution.audit.exact_cost
    row = [*costs, bool(solution.referee.survives), solution.iterations, learning, solving]
    return {"told": np.array(row, dtype=float)}


@cache
def _loaded() -> None:
    """Load all modules that a solve needs, so that the measured times include no imports."""
    solve(get("push-1d", N=2), Exact(), Direct())


ANALYTIC = ("gentle barrier", "barrier", "sharp barrier", "adaptive", "randomized")
"""Names of the smoothed laws that need no data."""
LEARNED = ("ewda", "wide ewda", "trusting ewda", "clean mlp", "noised mlp")
"""Names of the laws learned from data."""
LAWS = ("exact", *ANALYTIC, *LEARNED)
"""Names of all laws, in the order of the dataset."""
DRAWN = ("randomized", *LEARNED)
"""Names of the laws that depend on the seed."""
WITHIN = 0.1
"""Relative excess of a replay's cost over the exact optimum for which a plan counts as close to it."""
TENFOLD = 10.0
"""Ratio of mu in ``gentle barrier`` to mu in ``barrier``, and of mu in ``barrier`` to mu in ``sharp barrier``."""


def law_texts(settings: Mapping[str, Any]) -> dict[str, str]:
    """Return a mapping from each law to a text with its settings, given the parameters of the study."""
    mu, width, wide = settings["mu"], settings["width"], settings["wide"]
    texts = (
        "exact",
        *(f"barrier, mu = {mu * factor:g}" for factor in (TENFOLD, 1, 1 / TENFOLD)),
        f"adaptive, sigma = {settings['spread']:g}",
        f"randomized, sigma = {settings['sigma']:g}",
        f"EWDA, sigma = {width:g}",
        f"EWDA, sigma = {wide:g}",
        f"EWDA, sigma = {width:g}, trust",
        "MLP, clean data",
        f"MLP, noised, sigma = {width:g}",
    )
    return dict(zip(LAWS, texts, strict=True))


def excess_cost(data: xr.Dataset) -> xr.DataArray:
    """Return the relative excess of an exact replay's cost over the cost of the exact plan, (problem, law, seed)."""
    best = data["cost"].sel(law="exact", motion="exact replay")
    return data["cost"].sel(motion="exact replay") / best - 1


def replay_gap(cost: xr.DataArray) -> xr.DataArray:
    """Return the relative excess of the replay's cost over the plan's."""
    plan, replay = cost.sel(motion="plan"), cost.sel(motion="exact replay")
    return (replay - plan) / abs(plan)
