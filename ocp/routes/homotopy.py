"""Homotopy along a path of NLPs: warm starts, step-backs, and a table of stages."""

from __future__ import annotations

import logging
import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ocp.errors import InputError
from ocp.judge.route_report import StageRecord
from ocp.programs.options import ABANDONS
from ocp.programs.program import PENALTY, Program
from ocp.programs.solver import Point, Result, Solver, Status

logger = logging.getLogger(__name__)


Progress = Callable[[StageRecord], None]
IPOPT_WARM_START = {
    "warm_start_init_point": "yes",
    "warm_start_bound_push": 1e-9,
    "warm_start_bound_frac": 1e-9,
    "warm_start_slack_bound_push": 1e-9,
    "warm_start_slack_bound_frac": 1e-9,
    "warm_start_mult_bound_push": 1e-9,
}
IPOPT_PRIMAL_WARM_START = {
    "bound_push": 1e-9,
    "bound_frac": 1e-9,
    "slack_bound_push": 1e-9,
    "slack_bound_frac": 1e-9,
    "bound_mult_init_method": "mu-based",
}
"""IPOPT options for a warm start without multipliers: IPOPT estimates these and does not move the variables."""
STEP_BACKS = 4
"""Maximum number of retries of a stage that fails, each nearer to the last stage that converged."""
GIVEN_UP_GAIN = 1e-3
"""Relative reduction of a cost limit below which a path with this limit is given up."""
MAX_STAGES = 10_000
"""Maximum number of stages of a path, ten times as many as were ever useful."""


@dataclass(frozen=True)
class HomotopyStage:
    """One stage of a homotopy: reformulation, parameter values, bounds on the contact rows, and options.

    ``contact``, the lower and upper bound of contact rows, and a penalty are in natural units of the
    program. ``options`` are IPOPT's; another solver runs every stage with its own defaults. A ``partial``
    stage may end at its iteration limit; the next stage starts from its last iterate.
    """

    label: str
    value: float
    reformulation: str = "product"
    parameters: dict[str, float] = field(default_factory=dict)
    contact: tuple[float, float] | None = None
    options: dict[str, Any] = field(default_factory=dict)
    partial: bool = False


@dataclass(frozen=True)
class HomotopyPath:
    """Values of a parameter, from an easy value to the target, and the stage at each value.

    The path ends early if ``complete(program, result)`` is true; values from ``solved_to(program, result)`` on are
    skipped. A ``strict`` path must reach its last value; a path that only prepares the next path need not. The path is
    given up, without reaching its end, once its costs, extrapolated to the value 0, are not below ``cost_limit`` by a
    thousandth; or, before its last value, the follower has taken ``last_iteration`` iterations; or, with a finite
    ``cost_limit``, IPOPT's steps stay short (:data:`~ocp.programs.options.MAX_SHORT_STEPS`).
    """

    values: Sequence[float]
    stage_at: Callable[[float], HomotopyStage]
    strict: bool = True
    complete: Callable[[Program, Result], object] | None = None
    solved_to: Callable[[Program, Result], float] | None = None
    cost_limit: float = math.inf
    last_iteration: float = math.inf

    @property
    def reformulation(self) -> str:
        """Reformulation of the first stage."""
        return self.stage_at(self.values[0]).reformulation


@dataclass
class Trace:
    """Record of a route: the table of stages, points of accepted stages, iterations and seconds.

    ``refused`` is the reason why the last proposed exchange of contacts was rejected.
    """

    records: list[StageRecord] = field(default_factory=list)
    points: list[tuple[str, np.ndarray]] = field(default_factory=list)
    iterations: int = 0
    seconds: float = 0.0
    evaluation_s: float = 0.0
    refused: str = ""

    def absorb(self, trace: Trace) -> None:
        """Append the table of another trace and add its iterations and seconds."""
        self.records += trace.records
        self.iterations += trace.iterations
        self.seconds += trace.seconds
        self.evaluation_s += trace.evaluation_s
        self.refused = trace.refused


@dataclass(frozen=True)
class RouteResult:
    """Outcome of a route: the result and its NLP, the table of stages, and whether the route reached its end.

    ``nlp`` is the :class:`~ocp.programs.program.Program` in whose variables the result is given. ``on_branch`` is the
    same plan in the variables of the complementarity problem, or None if that was not solved. ``route`` is the name
    of the route in :mod:`ocp.routes.table`, "" for other outcomes.
    """

    result: Result
    nlp: Any
    finished: bool
    trace: Trace
    on_branch: Result | None = None
    route: str = ""


class Homotopy:
    """Solver that follows homotopy paths on the NLPs ``nlp_of(reformulation)``.

    A stage that fails is retried at the geometric mean of its value and the last solved value, up to four
    times between two values of the path. If a value cannot be reached, the result has ``finished = False``.
    ``prefers_pieces`` is whether solutions of the problem were found on its smooth pieces only, see
    :class:`~ocp.routes.pieces.NearbySolvers`.
    """

    def __init__(
        self,
        nlp_of: Callable[[str], Program],
        solver: Solver,
        values: dict[str, float],
        progress: Progress | None = None,
        trace: Trace | None = None,
    ) -> None:
        self.nlp_of, self.solver, self.values = nlp_of, solver, values
        self.progress, self.trace = progress, trace or Trace()
        self.prefers_pieces = False

    def follow(
        self,
        path: HomotopyPath,
        start: Point,
        warm: bool = False,
        source: Program | None = None,
        step_backs: int = STEP_BACKS,
    ) -> RouteResult:
        """Follow one path; return the last result, its program, and whether the end was reached.

        ``start`` is a point of ``source``, by default of the path's first program.
        """
        pending, last_good, attempts = list(path.values), None, 0
        point, best = start, None
        costs: list[tuple[float, float]] = []
        while pending:
            value = pending.pop(0)
            stage = path.stage_at(value)
            if np.isfinite(path.cost_limit):
                stage = replace(stage, options={**stage.options, ABANDONS: True})
            nlp = self.nlp_of(stage.reformulation)
            usable = translate(point, source or nlp, nlp)
            result = self.solve_stage(stage, nlp, usable, warm or last_good is not None)
            if result.ok or (stage.partial and result.status is Status.ITERATION_LIMIT):
                point, source, last_good = result.point, nlp, value
                attempts = 0 if value in path.values else attempts
                best = (result, nlp)
                costs += [(value, result.f)] if result.ok else []
                is_dear = costs and extrapolate(costs) + GIVEN_UP_GAIN * abs(result.f) >= path.cost_limit
                if is_dear or (pending and self.trace.iterations >= path.last_iteration):
                    return RouteResult(result, nlp, False, self.trace)
                if path.complete is not None and path.complete(nlp, result):
                    break
                if path.solved_to is not None:
                    solved_to = path.solved_to(nlp, result)
                    pending = [value for value in pending if value < solved_to]
                continue
            if last_good is None or attempts >= step_backs or value == 0:
                if path.strict or best is None:
                    return RouteResult(result, nlp, False, self.trace)
                break
            attempts += 1
            pending = [math.sqrt(last_good * value), value, *pending]
        assert best is not None
        return RouteResult(*best, True, self.trace)

    def solve_stage(self, stage: HomotopyStage, nlp: Program, start: Point, warm: bool) -> Result:
        """Solve one stage and add its line to the table."""
        values = {**self.values, **stage.parameters}
        values[PENALTY] *= nlp.natural.f
        p, bounds = nlp.parameter_vector(values), nlp.bounds(values)
        if stage.contact is not None and "contact" in nlp.constraints:
            rows = nlp.constraints["contact"].index.ravel()
            lower, upper = stage.contact
            bounds["lbg"][rows] = lower * nlp.natural.g[rows]
            bounds["ubg"][rows] = upper * nlp.natural.g[rows]
        options: dict[str, Any] = {}
        usable = start if warm else Point(start.x)
        if self.solver.name == "ipopt":
            options = {**IPOPT_WARM_START, **stage.options} if usable.lam_g is not None else stage.options
        result = self.solver.run(nlp, usable, p, bounds, **options)
        return self.record(stage.label, stage.value, nlp, result, p, bounds)

    def record(
        self, label: str, value: float, nlp: Program, result: Result, p: np.ndarray, bounds: dict[str, np.ndarray]
    ) -> Result:
        """Add a line to the table, call ``progress``, and return the result."""
        g = result.g
        contact_violation = np.maximum(bounds["lbg"] - g, g - bounds["ubg"])
        line = StageRecord(
            label=label,
            value=value,
            cost=result.f + nlp.constant(p),
            complementarity=float(np.abs(nlp.products(result.point.x, p)).max(initial=0.0)),
            residual=float(np.maximum(contact_violation, 0).max(initial=0.0)),
            iterations=result.iterations,
            seconds=result.seconds,
            status=result.word,
            accepted=result.ok,
            evaluation_s=result.evaluation_s,
        )
        self.trace.records.append(line)
        self.trace.iterations += result.iterations
        self.trace.seconds += result.seconds
        self.trace.evaluation_s += result.evaluation_s
        logger.info(
            "%s %.3g: cost %.7g, lam gap %.1e, residual %.1e, %d it, %.3f s, %s",
            label,
            value,
            line.cost,
            line.complementarity,
            line.residual,
            line.iterations,
            line.seconds,
            line.status,
        )
        if result.ok:
            self.trace.points.append((nlp.reformulation, result.point.x))
        if self.progress is not None:
            self.progress(line)
        return result


def translate(point: Point, source: Program, target: Program) -> Point:
    """Convert a point of ``source`` to a point of ``target``: common blocks are copied, other blocks are zero."""
    if source is target:
        return point

    def copy_blocks(vector: np.ndarray | None, old: Any, new: Any) -> np.ndarray | None:
        if vector is None:
            return None
        blocks = old.unpack(vector)
        return new.pack(
            {name: blocks[name] for name in new.blocks if name in blocks and blocks[name].shape == new[name].shape}
        )

    x = copy_blocks(point.x, source.variables, target.variables)
    assert x is not None
    return Point(
        x,
        copy_blocks(point.lam_x, source.variables, target.variables),
        copy_blocks(point.lam_g, source.constraints, target.constraints),
    )


def extrapolate(costs: Sequence[tuple[float, float]]) -> float:
    """Return the cost at the value 0, linear through the last two of pairs of value and cost.

    The optimal cost of a relaxation ``lam gap <= t`` is differentiable in t, with the multipliers of the products.
    """
    (value, cost), (earlier_value, earlier_cost) = costs[-1], costs[max(len(costs) - 2, 0)]
    slope = (earlier_cost - cost) / (earlier_value - value) if earlier_value > value else 0.0
    return cost - slope * value


def geometric(start: float, end: float, factor: float) -> list[float]:
    """Return a geometric sequence from ``start`` down to exactly ``end``, with a ratio of at least ``factor``.

    Raises :class:`~ocp.errors.InputError` for more than :data:`MAX_STAGES` values, and if the ratio of
    the ends underflows.
    """
    if start <= end:
        return [end]
    ratio = end / start
    if ratio < sys.float_info.min:
        raise InputError(f"{end:g} is too far below {start:g} for a homotopy; take values closer together")
    # The count is reduced slightly, since rounding would add a stage where the ratio is a power of the factor.
    count = max(1, math.ceil(math.log(ratio) / math.log(factor) - 1e-9))
    if count > MAX_STAGES:
        raise InputError(
            f"a factor of {factor!r} makes {count:.3g} stages from {start:g} down to {end:g}, and"
            f" {MAX_STAGES} is the maximum; take a smaller factor"
        )
    return [start * ratio ** (i / count) for i in range(count)] + [end]


COST_GAIN = 1e-7
"""Relative reduction of the cost above which one solution replaces another."""


def lower(candidate: Result, incumbent: Result, margin: float = COST_GAIN) -> bool:
    """Return whether the candidate's cost is below the incumbent's by more than the relative ``margin``."""
    return candidate.f < incumbent.f - margin * abs(incumbent.f)


def better(incumbent: RouteResult | None, candidate: RouteResult) -> RouteResult:
    """Return the better of two outcomes of the same problem.

    | incumbent | candidate | returned |
    |---|---|---|
    | none | any | candidate |
    | finished | not | incumbent |
    | not | finished | candidate |
    | both | both, or neither | candidate if its cost is lower, else incumbent |
    """
    if incumbent is None or (candidate.finished and not incumbent.finished):
        return candidate
    if incumbent.finished and not candidate.finished:
        return incumbent
    return candidate if lower(candidate.result, incumbent.result) else incumbent
