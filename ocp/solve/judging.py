"""Judgement of a result, or of the best point of an interrupted solve, by audit, certificate and referee."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from dynamics.learned.laws import LearnedLaw
from ocp.errors import InputError, NotConverged, abbreviated, interruptible
from ocp.judge.audit import Audit, audit_result, is_feasible
from ocp.judge.certificate import UNJUDGED, Certificate, certify
from ocp.judge.findings import Finding
from ocp.judge.idling import CONTENT, STILL, cost_span, idle_cost, undone_findings
from ocp.judge.referee import Referee, referee_plan, referee_replay
from ocp.judge.route_report import RouteReport
from ocp.judge.sensitivity import sensitivity
from ocp.judge.unbounded import runaway_inputs, unbounded_inputs, unbounded_variables
from ocp.problem.evaluation import Evaluation
from ocp.problem.problem import Problem
from ocp.problem.rollout import Rollout
from ocp.programs.program import ON_KINK, PENALTY, Program
from ocp.programs.solver import Point, Result, Status
from ocp.routes.homotopy import Progress, RouteResult, StageRecord, Trace, translate
from ocp.routes.session import Session
from ocp.routes.table import route_for
from ocp.solution import Interrupted, Solution
from ocp.solve.labelling import label
from ocp.store.provenance import versions
from ocp.transcription.factories import law_record
from ocp.transcription.nlp import Trajectories, trajectories

_NO_TASK_GRADIENT = 1e-7
"""Relative gradient of the task's cost below which no input changes it."""
_IDLE = 1e-6
"""Cost saved, relative to the cost of standing still, below which a plan achieves nothing."""


def judge_outcome(session: Session, outcome: RouteResult, seed: int) -> Solution:
    """Return the labelled solution of an outcome, with audit, certificate, referee's report and status."""
    start_time = time.perf_counter()
    nlp, result = outcome.nlp, outcome.result
    evaluation = session.evaluation
    values = evaluation.values
    p, bounds = nlp.parameter_vector(values), nlp.bounds(values)
    plan = trajectories(nlp, result, p)
    audit, replay, contacts = audit_result(nlp, result, plan, evaluation, p, bounds)
    feasible = is_feasible(nlp, audit)
    # The solver's f is not used, since it may include a penalty on gains or on products of contact pairs.
    rolled = Rollout.from_trajectories(evaluation, nlp.step, plan.x, plan.u, plan.lam, plan.gap)
    certificate = Certificate("undecided", reason=UNJUDGED)
    idle, span, derivative, undone = float("nan"), 0.0, None, list[Finding]()
    endless = unbounded_inputs(evaluation, session.step, rolled)
    if feasible:
        span = cost_span(evaluation, rolled)
        program, point = route_for(session).invert(session, outcome, rolled, plan.gains)
        judged_values = {**values, PENALTY: 0.0}
        arguments = program.parameter_vector(judged_values), program.bounds(judged_values)
        certificate = certify(program, point.x, *arguments, point.lam_g)
        if certificate.stationarity == "not":
            certificate = _certified_at_kinks(session, point.x, judged_values) or certificate
        if certificate.stationarity == "not":
            certificate = replace(certificate, reason=outcome.trace.refused)
        replay_moved = partial(_replay, session.problem)
        derivative = partial(sensitivity, program, point, judged_values, replay_moved)
        idle = idle_cost(evaluation, session.step, rolled)
        undone = list(undone_findings(evaluation, rolled, audit.contacts, span))
        limited = all(np.isfinite(limit).all() for limit in evaluation.limits[2:4])
        endless = endless or ("" if limited else unbounded_variables(program, *arguments, point.x))
    if not (endless or result.ok or certificate.certified):
        # Iterates may also diverge to higher costs, as from the kinks of |u|: the problem is not unbounded then.
        uphill = rolled.cost > idle_cost(evaluation, session.step, rolled)
        endless = "" if uphill else runaway_inputs(session.problem, plan.u)
    report, replays = referee_plan(evaluation, session.step, rolled, plan.gains)
    return Solution(
        arrays=label(nlp, plan, replay, contacts, outcome, evaluation, replays.replay),
        cost=rolled.cost,
        status=status_of(outcome, audit, certificate, rolled.cost, idle, span, evaluation, bool(endless)),
        audit=audit,
        certificate=certificate,
        referee=report,
        idle_cost=idle,
        stages=outcome.trace.records,
        iterations=outcome.trace.iterations,
        build_s=session.total_build_s,
        solve_s=outcome.trace.seconds,
        record=session_record(session, seed),
        route=RouteReport(outcome.route, audit_s=time.perf_counter() - start_time),
        unbounded=endless,
        undone=undone,
        problem=session.problem,
        values=dict(values),
        gains=plan.gains,
        evaluation_s=outcome.trace.evaluation_s,
        derivative=derivative,
    )


def _certified_at_kinks(session: Session, x: np.ndarray, values: dict[str, float]) -> Certificate | None:
    """Return the certificate of a point on kinks under the exact law, None elsewhere and under other laws."""
    if session.step.exact and session.judging_nlp().is_near_kink(x, values, ON_KINK):
        from ocp.judge.kinks import certify_at_kinks

        return certify_at_kinks(session.pieces, x, values)
    return None


def _replay(problem: Problem, plan: Trajectories, values: dict[str, float]) -> Referee:
    inputs = plan.u if plan.gains is None else plan.gains
    return referee_replay(Evaluation(problem, values), inputs, plan.x[:, 0])


def status_of(
    outcome: RouteResult,
    audit: Audit,
    certificate: Certificate,
    cost: float,
    idle: float,
    span: float,
    evaluation: Evaluation,
    unbounded: bool,
) -> Status:
    """Return the status by audit and certificate, or the solver's status if they do not confirm a solution."""
    result = outcome.result
    if result.status is Status.INTERRUPTED:
        return result.status
    if unbounded:
        return Status.UNBOUNDED
    if not np.isfinite(cost):
        return Status.DIVERGED
    if not is_feasible(outcome.nlp, audit):
        return Status.INEXACT if result.ok else result.status
    # A force at a distance moves bodies that do not move in the exact replay: the cause is smoothing, not idling.
    # If standing still violates constraints that the plan satisfies, the plan is better.
    stands_still = audit.state_gap <= STILL * outcome.nlp.problem.scales.x.max() and np.isfinite(idle)
    blind = audit.active_steps == 0 and audit.task_gradient < _NO_TASK_GRADIENT and stands_still
    sloped = certificate.slope > CONTENT * span
    gain = evaluation.cost_share(idle - cost, idle)
    if blind or (sloped and gain <= _IDLE):
        return Status.NO_PROGRESS
    if certificate.certified:
        return Status.SOLVED
    if not result.ok:
        return result.status
    return Status.UNDECIDED if certificate.stationarity == "undecided" else Status.NOT_OPTIMAL


def session_record(session: Session, seed: int) -> dict[str, Any]:
    """Return a JSON-serialisable dict of everything that determines a solution."""
    problem, policy = session.problem, session.policy
    learned = session.law if isinstance(session.law, LearnedLaw) else None
    return {
        "problem": problem.name,
        **law_record(session.law),
        "method": session.method.name,
        "policy": policy.name,
        "policy_settings": asdict(policy),
        "solver": session.solver.name,
        "solver_options": session.solver.options,
        "strategy": session.strategy if session.complementary else None,
        "effort": session.rollout_steps or session.effort,
        "jit": session.compiled.outcome if session.compiled else None,
        "params": {**{name: session.values[name] for name in problem.parameters.names}, **problem.origin.settings},
        "law_parameters": {
            name: session.values[name] for name in session.step.p.names if name not in problem.parameters
        },
        "N": problem.N,
        "learned_at": learned.learned_at(problem.system, session.values) if learned else {},
        "seed": seed,
        "versions": versions(),
        "citation": problem.origin.citation,
        "source": problem.origin.source,
    }


logger = logging.getLogger(__name__)
FEASIBLE = 1e-6
"""Largest violation of a constraint or bound, in natural units, of a feasible point."""


@contextmanager
def keep_best_on_interrupt(session: Session, seed: int, progress: Progress | None) -> Iterator[Progress]:
    """Yield the callback that a solve of the session calls after each stage.

    If Ctrl-C ends the solve, raises :class:`~ocp.solution.Interrupted` with its best point as a judged
    solution of status :attr:`~ocp.programs.solver.Status.INTERRUPTED`; before the first run of the
    solver has ended, KeyboardInterrupt propagates.
    """
    recorder = InterruptRecorder(session, progress)
    session.solver.on_result = lambda program, result: recorder.ends.append((program, result))
    try:
        with interruptible():
            yield recorder.add_stage
    except KeyboardInterrupt as stop:
        session.solver.on_result = None
        if not recorder.ends:
            raise
        raise Interrupted(recorder.solution(seed)) from stop
    finally:
        session.solver.on_result = None


@dataclass
class InterruptRecorder:
    """Recorder of the stages of a solve, and of the program and result of each run of the solver."""

    session: Session
    progress: Progress | None
    records: list[StageRecord] = field(default_factory=list)
    ends: list[tuple[Program, Result]] = field(default_factory=list)

    def add_stage(self, stage: StageRecord) -> None:
        """Record a stage, and pass it to the ``progress`` callback."""
        self.records.append(stage)
        if self.progress is not None:
            self.progress(stage)

    def solution(self, seed: int) -> Solution:
        """Return the best point as a judged solution, with the iterations and seconds of all runs."""
        nlp = self.session.nlp_of("product")
        results = [result for _, result in self.ends]
        trace = Trace(
            records=self.records,
            iterations=sum(result.iterations for result in results),
            seconds=sum(result.seconds for result in results),
            evaluation_s=sum(result.evaluation_s for result in results),
        )
        p = nlp.parameter_vector(self.session.values)
        point = self._best(nlp, p)
        logger.info("interrupted after %d stages; the best point is judged", len(self.records))
        result = Result.at(nlp, point, p, Status.INTERRUPTED, "interrupted")
        return judge_outcome(self.session, RouteResult(result, nlp, False, trace), seed)

    def _best(self, nlp: Program, p: np.ndarray) -> Point:
        """Return the cheapest feasible point or, if none is feasible, the least infeasible point."""
        bounds = nlp.bounds(self.session.values)
        candidates = []
        for program, result in self.ends:
            point = translate(result.point, program, nlp)
            cost, g = nlp.values(point.x, p)
            violation = nlp.largest_violation(point.x, g, bounds)
            candidates.append((violation, cost if np.isfinite(cost) else np.inf, point))
        feasible = [candidate for candidate in candidates if candidate[0] <= FEASIBLE]
        by_cost = min(feasible, key=lambda candidate: candidate[1], default=None)
        return (by_cost or min(candidates, key=lambda candidate: candidate[0]))[2]


@contextmanager
def collect_failures(failures: list[Exception]) -> Iterator[None]:
    """Append an exception raised by one of several candidates to ``failures``, so that the others are tried.

    An :class:`~ocp.errors.InputError`, which every candidate would raise, propagates.
    """
    try:
        with interruptible():
            yield
    except InputError:
        raise
    except NotConverged as error:
        failures.append(error)
    except Exception as error:
        logger.exception("a candidate ended in an error")
        failures.append(error)


def add_failures(solution: Solution, failures: list[Exception]) -> Solution:
    """Return the solution with the errors of failed candidates, if any, added to its route report."""
    messages = [f"{type(error).__name__}: {abbreviated(str(error))}" for error in failures]
    return solution.with_route(failures=messages)
