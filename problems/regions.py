"""Regions from which transitions of a problem are sampled: declared in its file, or built around its task."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from dynamics.learned.collecting import Drawn, Piece, draw_piece
from dynamics.learned.region import Region
from dynamics.systems import ContactSystem
from ocp.errors import InputError
from ocp.jobs.scheduling import Report
from ocp.problem.problem import Problem
from ocp.store.provenance import check_content
from problems import registry
from problems.spec import ProblemSpec

TUBE_SPREAD = 0.3
"""Standard deviation of states around the line from start to goal, in the states' characteristic sizes."""


@dataclass(frozen=True)
class CollectJob:
    """Arguments for a worker that samples one piece of the transitions of a problem (a name or a file)."""

    problem: str
    params: dict[str, Any]
    content: str
    piece: Piece


def collect_piece(job: CollectJob, report: Report) -> Drawn:
    """Sample the transitions of one piece; a :data:`~ocp.jobs.scheduling.Function` for workers.

    Raises :class:`~ocp.store.provenance.FilesChanged` if the problem's file has changed.
    """
    spec = registry.spec(job.problem)
    check_content(job.problem, job.content, [spec.digest], {})
    problem = spec.problem(job.params)
    region = region_of(spec, spec.params(job.params), problem)
    return draw_piece(problem.exact_step, region, job.piece)


def region_of(spec: ProblemSpec, params: Any, problem: Problem) -> Region:
    """Return the region that the problem's file declares, else :func:`around_task`.

    Raises :class:`~ocp.errors.InputError` for a user's ``region`` that raises or does not fit the problem.
    """
    owner = spec.path or spec.name
    region = around_task(problem) if spec.region is None else spec.region(params)
    if not isinstance(region, Region):
        raise InputError(
            f"{owner}: region(params) returned {type(region).__name__}, expected a dynamics.learned.region.Region"
        )
    try:
        region.check(problem.system)
    except (TypeError, ValueError) as error:
        raise InputError(f"{owner}: {error}") from error
    return region


def around_task(problem: Problem) -> Region:
    """Return a region of states around start, goal and guess, widened by their scales, and of inputs in their bounds.

    The goal is the minimum of the terminal cost, approximated as quadratic at the start; coordinates on which
    the cost does not depend have their start values. Inputs without bounds have the range of the
    guess, widened by their scales; states stay within their bounds. A state that no step changes, such as
    a step size to be optimised, has the range of its initial value, and its initial value on the line
    from start to goal.
    """
    p, sizes, system = problem.parameters.values, problem.scales, problem.system
    x0, _, *bounds = (np.array(value).ravel() for value in problem.limits(p))
    u_low, u_high, x_low, x_high = bounds
    X, U = problem.initial_guess(p)
    goal = np.clip(_goal(problem, x0, p), x_low, x_high)
    nodes = np.vstack([X, x0, goal])
    low = np.maximum(nodes.min(axis=0) - sizes.x, x_low)
    high = np.minimum(nodes.max(axis=0) + sizes.x, x_high)
    unchanging, chosen = _unchanging(system), [np.array(v).ravel() for v in problem.start_limits(p)]
    low, high = (np.where(unchanging, end, bound) for end, bound in zip(chosen, (low, high), strict=True))
    goal = np.where(unchanging, x0, goal)
    u_low = np.where(np.isfinite(u_low), u_low, U.min(axis=0) - sizes.u)
    u_high = np.where(np.isfinite(u_high), u_high, U.max(axis=0) + sizes.u)
    return Region(
        _ranges([s.name for s in system.states], low, high),
        _ranges([s.name for s in system.inputs], u_low, u_high),
        x0.tolist(),
        goal.tolist(),
        np.where(unchanging, 0.0, TUBE_SPREAD * sizes.x).tolist(),
    )


def _unchanging(system: ContactSystem) -> np.ndarray:
    """Return a mask (nx,) of the states that no step changes: their residual is x_next - x."""
    pairs = zip(*(ca.vertsplit(vector) for vector in (system.x, system.x_next)), strict=True)
    still = [next_state - state for state, next_state in pairs]
    rows = ca.vertsplit(system.residual)
    return np.array([ca.is_equal(*pair, 3) for pair in zip(rows, still, strict=True)])


def _goal(problem: Problem, x0: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Return the state (nx,) after one Newton step from ``x0`` on the terminal cost, or ``x0`` if it is not finite."""
    x = problem.system.x
    curvature, slope = ca.hessian(problem.terminal_cost, x)
    symbols = [x, problem.parameters.vector]
    derivatives = ca.Function("end", symbols, [ca.densify(curvature), ca.densify(slope)])
    H, g = (np.array(value) for value in derivatives(x0, p))
    step = np.linalg.pinv(H, hermitian=True) @ g if np.isfinite([H.sum(), g.sum()]).all() else 0 * g
    return x0 - step.ravel()


def _ranges(names: list[str], low: np.ndarray, high: np.ndarray) -> dict[str, tuple[float, float]]:
    pairs = zip(low.tolist(), high.tolist(), strict=True)
    return dict(zip(names, pairs, strict=True))
