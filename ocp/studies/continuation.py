"""Follow a solution along a parameter: one built NLP, warm starts, an adaptive step."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ocp.errors import InputError
from ocp.judgement import judged
from ocp.routes.outcome import Outcome
from ocp.session import Session
from ocp.solution import Solution, Status

SMALLEST = 1e-3
"""The step along the path is never smaller than this fraction of the asked one."""
_EASY = 15


@dataclass(frozen=True)
class PathPoint:
    """One solved point: the parameter's value and the judged solution there."""

    value: float
    solution: Solution

    def row(self) -> dict[str, Any]:
        """The point as JSON tells it."""
        found = self.solution
        return {
            "value": self.value,
            "status": found.status.label,
            "success": found.success,
            "cost": found.cost,
            "exact_cost": found.audit.exact_cost,
            "referee_cost": found.referee.cost,
            "survives": found.referee.survives,
            "stationarity": found.certificate.stationarity,
            "iterations": found.iterations,
            "complementarity": found.audit.complementarity,
        }


@dataclass
class Continuation:
    """A followed path: its points, the iterations in all, and where and why it broke, if so."""

    parameter: str
    points: list[PathPoint] = field(default_factory=list)
    iterations: int = 0
    nlp_builds: int = 0
    broke: str | None = None


def resolve(session: Session, over: str) -> str:
    """Find the parameter that ``over`` means: ``contact.mu``, ``M`` or ``problem.M``.

    Raises :class:`~ocp.errors.InputError` with the names that there are.
    """
    names = [*session.problem.parameters.names, *session.step.p.names]
    for candidate in (over, over.removeprefix("problem.")):
        if candidate in names:
            return candidate
    listed = ", ".join(dict.fromkeys(names))
    raise InputError(f"there is no parameter {over!r} to continue over; there are {listed}")


def continue_over(
    session: Session,
    over: str,
    start: float,
    end: float,
    steps: int = 20,
    scale: str = "linear",
    progress: Callable[[PathPoint], None] | None = None,
    seed: int = 0,
) -> Continuation:
    """Follow the solution from ``start`` to ``end`` in ``steps`` steps, equal on ``scale``.

    The first point is solved as any problem is; every further one starts at the last answer with
    its multipliers, on the same NLP. A step that fails is halved, down to a thousandth of the
    asked one; after easy points a halved step doubles back towards it. Where not even the smallest
    step succeeds the path is said to break, with the reason, and the points so far are kept.

    Raises :class:`~ocp.errors.InputError` for an unknown parameter or scale, fewer than one step,
    equal or non-finite ends, or a log scale through zero.
    """
    name = resolve(session, over)
    to_value, to_scale = _scale(scale, start, end, steps)
    path = Continuation(name)
    session.values[name] = start
    outcome = session.solve()
    if not _add(path, session, outcome, start, seed, progress):
        path.broke = f"at the first point, {name} = {start:g}: {path.points[-1].solution.verdict}"
        return _finished(path, session)
    s, goal, asked = to_scale(start), to_scale(end), 1.0 / steps
    span, at, step = goal - s, 0.0, asked
    while at < 1 - 1e-12:
        target = min(1.0, at + step)
        value = end if target >= 1 - 1e-12 else to_value(s + span * target)
        session.values[name] = value
        point, nlp = outcome.result.point, outcome.nlp
        tried = session.solve(start=point, warm_from=nlp)
        if _add(path, session, tried, value, seed, progress):
            outcome, at = tried, target
            easy = tried.trace.iterations <= _EASY
            step = min(asked, 2 * step) if easy else step
            continue
        failed = path.points.pop()
        step /= 2
        if step < SMALLEST * asked:
            path.broke = (
                f"after {name} = {path.points[-1].value:g}, on the way to {value:g}:"
                f" {failed.solution.verdict}{_worst(failed.solution)}"
            )
            break
    return _finished(path, session)


def _add(path: Continuation, session: Session, outcome: Outcome, value: float, seed: int,
         progress: Callable[[PathPoint], None] | None) -> bool:  # fmt: skip
    solution = judged(session, outcome, seed)
    point = PathPoint(value, solution)
    path.points.append(point)
    path.iterations += solution.iterations
    good = outcome.finished and solution.status in (Status.SOLVED, Status.NO_PROGRESS)
    if good and progress is not None:
        progress(point)
    return good


def _finished(path: Continuation, session: Session) -> Continuation:
    path.nlp_builds = session.nlp_builds
    return path


def _worst(solution: Solution) -> str:
    if not solution.audit.worst:
        return ""
    worst = solution.audit.worst[0]
    return f" Worst: {worst.name} of {worst.component} at step {worst.step}, {worst.amount:.1e}."


def _scale(
    scale: str, start: float, end: float, steps: int
) -> tuple[Callable[[float], float], Callable[[float], float]]:
    if not (math.isfinite(start) and math.isfinite(end) and start != end):
        raise InputError(f"--from and --to must be finite and differ, got {start} and {end}")
    if steps < 1:
        raise InputError(f"--steps must be 1 or more, got {steps}")
    if scale == "linear":
        return (lambda s: s), (lambda v: v)
    if scale == "log":
        if start * end <= 0 or start < 0:
            raise InputError(f"a log scale needs positive ends, got {start} and {end}")
        return math.exp, math.log
    raise InputError(f"--scale must be log or linear, got {scale!r}")


def path_dataset(path: Continuation) -> Any:
    """Points as one dataset over dimension ``point``, with every trajectory."""
    import xarray as xr

    keep = ("x", "u", "lam", "gap", "x_replay", "u_replay", "lam_replay", "gap_replay", "K", "k")
    parts = [point.solution.data[[n for n in keep if n in point.solution.data]]
             for point in path.points]  # fmt: skip
    data = xr.concat(parts, dim="point", join="override", combine_attrs="override")
    data = data.assign_coords(value=("point", np.array([point.value for point in path.points])))
    for key in ("cost", "exact_cost", "iterations", "complementarity"):
        data[key] = ("point", np.array([point.row()[key] for point in path.points], dtype=float))
    return data
