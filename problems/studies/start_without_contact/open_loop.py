"""Plans from a start without contact, by IPOPT: of input sequences under four contact laws."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from dynamics.contact import Adaptive, Barrier, ContactLaw, Exact, Randomized
from ocp import SingleShooting, Solution, solve
from ocp.problem import Problem
from problems.registry import get
from problems.studies.study import quantity_of

if TYPE_CHECKING:
    from problems.studies.start_without_contact.data import Params

PROBLEMS = ("planar-push", "planar-hand")
LAWS = ("exact", "barrier", "adaptive", "randomized")
_NODES = 21
"""Nodes of a plan, which all have: twenty steps."""


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
        "cost": quantity_of((*both, "of"), found["cost"], "1", "cost of the object"),
        "total": quantity_of((*both, "motion"), found["total"], "1", "whole cost"),
        "iterations": quantity_of(both, found["iterations"], "1", "iterations of the solver"),
        "status": (both, found["status"]),
        "path": quantity_of((*both, "motion", "node", "pose"), found["path"], "m, m, rad",
                            "pose of the object"),
    }, {
        "problem": list(PROBLEMS),
        "law": list(LAWS),
        "of": ["at rest", "plan", "exact replay"],
        "motion": ["plan", "exact replay"],
        "pose": ["x", "y", "angle"],
    }  # fmt: skip
