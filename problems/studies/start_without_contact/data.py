"""N2: does the object move? Planned from a start without contact, under four contact laws."""

from __future__ import annotations

import numpy as np
import xarray as xr

from dynamics.contact import Adaptive, Barrier, ContactLaw, Exact, Randomized
from ocp import SingleShooting, Solution, Status, solve
from ocp.problem import Problem
from ocp.referee import COST_SHARE
from problems.registry import get
from problems.spec import Citation
from problems.studies.study import (
    CHOICE,
    CODE,
    Claim,
    Study,
    StudyParams,
    over,
    quantity_of,
    setting,
)

PROBLEMS = ("planar-push", "planar-hand")
LAWS = ("exact", "barrier", "adaptive", "randomized")
_NODES = 21
"""Nodes of a plan, which all have: twenty steps."""
_PROGRESS = 0.8
"""Part of the object's cost at rest that a plan saves, to have made progress."""


class Params(StudyParams):
    """Parameters of N2; those of the problems are the problems' own defaults."""

    mu: float = setting(1e-3, "N s m", "central-path parameter of the barrier law", CODE, above=0)
    spread: float = setting(0.02, "m", "width of the adaptive law", CHOICE, above=0)
    sigma: float = setting(0.1, "m or rad", "noise on the input, randomized law", CHOICE, above=0)
    samples: int = setting(8, "1", "samples of the randomized law, even", CHOICE, least=2)


def law_of(name: str, params: Params) -> ContactLaw:
    """Return the contact law called ``name`` at the study's settings."""
    if name == "exact":
        return Exact()
    if name == "barrier":
        return Barrier(mu=params.mu)
    if name == "adaptive":
        return Adaptive(sigma=params.spread)
    return Randomized(sigma=params.sigma, samples=params.samples, seed=params.seed)


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
    stages = [problem.cost_terms(state, still, still, p) for state in x]
    return sum(float(stage) for stage, _ in stages[:-1]) + float(stages[-1][1])


def gains(name: str, found: Solution) -> tuple[float, float, float]:
    """Object's cost: standing still, as planned, and as replayed under the exact law."""
    planned, replay = found.data["x"].values[0], found.data["x_replay"].values[0]
    start = np.broadcast_to(planned[0], planned.shape)
    return object_cost(name, start), object_cost(name, planned), object_cost(name, replay)


def run(params: Params) -> xr.Dataset:
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
    both = ("problem", "law")
    return xr.Dataset(
        {
            "cost": quantity_of((*both, "of"), cost, "1", "cost of the object"),
            "total": quantity_of((*both, "motion"), total, "1", "whole cost"),
            "iterations": quantity_of(both, moved, "1", "iterations of the solver"),
            "status": (both, status),
            "path": quantity_of((*both, "motion", "node", "pose"), path, "m, m, rad",
                                "pose of the object"),
        },
        {
            "problem": list(PROBLEMS),
            "law": list(LAWS),
            "of": ["at rest", "plan", "exact replay"],
            "motion": ["plan", "exact replay"],
            "pose": ["x", "y", "angle"],
        },
    )  # fmt: skip


def claims(data: xr.Dataset) -> list[Claim]:
    """What sec. V-B says of the exact and the smoothed dynamics, and what a replay keeps."""
    return [claim for name in PROBLEMS for claim in _claims(name, data.sel(problem=name))]


def _claims(name: str, data: xr.Dataset) -> list[Claim]:
    """Of one problem: stuck under the exact law, moved under the smoothed ones, replayed."""
    place = "Noising data, sec. V-B and fig. 2"
    smooth = [law for law in LAWS if law != "exact"]
    rest, stuck, _ = (float(v) for v in data["cost"].sel(law="exact"))
    word = str(data["status"].sel(law="exact").values)
    fall = {law: 1 - float(data["cost"].sel(law=law, of="plan")) / rest for law in smooth}
    plan, replay = data["total"].sel(law=smooth).values.T
    dearer = (replay - plan) / np.abs(plan)
    kept = dearer <= COST_SHARE
    others = [law for law in smooth if law != "randomized"]
    moved = [fall[law] >= _PROGRESS for law in others]
    expected = f"the object's cost falls by {_PROGRESS:.0%} or more"
    return [
        Claim(f"{name}: the exact dynamics make no progress from a start without contact", place,
              "the object's cost as at rest", f"{stuck:.6g} of {rest:.6g}, {word}",
              bool(abs(stuck - rest) <= 1e-9 * rest and word == Status.NO_PROGRESS.label)),
        Claim(f"{name}: randomized smoothing makes progress", place, expected,
              f"{fall['randomized']:.1%}", bool(fall["randomized"] >= _PROGRESS)),
        Claim(f"{name}: so do the barrier and the adaptive law", "our check", expected,
              f"{over(others, moved)}: " + ", ".join(f"{fall[law]:.1%}" for law in others),
              bool(all(moved))),
        Claim(f"{name}: the plan keeps its cost under the exact law", "our check",
              f"its replay costs at most {COST_SHARE:.0%} more, of all of the cost",
              f"{over(smooth, kept)}: " + ", ".join(f"{part:+.1%}" for part in dearer),
              bool(np.all(kept))),
    ]  # fmt: skip


study = Study(
    id="N2",
    title="Pushing and turning from a start without contact",
    citation=Citation("suh2023noising", "Fig. 2 and sec. V-B"),
    Params=Params,
    run=run,
    claims=claims,
    notes=(
        "Only the dynamics f and f_σ of the figure, beside two laws that the paper has not;"
        " IPOPT over input sequences instead of Adam over gains, which are redundant along one"
        " trajectory.",
        "The cost shown is the object's part alone: under the exact law the actuator still goes to"
        " its rest.",
        "The average over noise of exact steps has kinks at which no gradient method can end; its"
        " plan is found by direct transcription of the same average and rolled out.",
    ),
)
