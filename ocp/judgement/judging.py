"""Three judges of one outcome: the audit with the certificate, the referee, and the solver's word.

Owns how they are put together into one status; each of them knows nothing of the others.
"""

from __future__ import annotations

import time
from dataclasses import asdict, replace
from functools import partial
from typing import Any

import numpy as np

from dynamics.learned.laws import LearnedLaw
from ocp.judges.audit import audit, feasible
from ocp.judges.findings import Audit, RefereeFindings
from ocp.judges.referee import RefereeReport, evaluate
from ocp.judges.verdict import UNJUDGED
from ocp.physics.constraints import broken_constraints
from ocp.physics.nonuniqueness import Nonuniqueness
from ocp.problem import Problem, Scales
from ocp.programs.solver import Point
from ocp.programs.status import Status
from ocp.rollout import Gains, Rollout, roll_on, trajectory_costs
from ocp.routes.homotopy import translate
from ocp.routes.outcome import Outcome
from ocp.routes.rollout_starts import pack_rollout
from ocp.session import Session
from ocp.solution import Solution
from ocp.stationarity.certificate import Certificate, certify
from ocp.stationarity.sensitivity import sensitivity
from ocp.store.dataset import label
from ocp.store.provenance import versions
from ocp.transcription.nlp import NLP
from ocp.transcription.trajectories import trajectories

_FLAT = 1e-7
_IDLE = 1e-6
"""Relative gain over standing still below which nothing was achieved."""
_CONTENT = 1e-4
"""Share of the cost's span below which its gradient wants nothing: standing still is the answer."""
_STILL = 0.05
"""Share of the states' characteristic size that an input may move in a horizon and yet hold."""
_SHARP = 1e-4
"""Share of the characteristic mu at which a step of the barrier law is nearly the exact one."""


def judged(session: Session, outcome: Outcome, seed: int) -> Solution:
    """Audit an outcome, certify and referee it, label it, and say what came of it."""
    began = time.perf_counter()
    nlp, result = outcome.nlp, outcome.result
    values = session.values
    p, bounds = nlp.parameter_vector(values), nlp.bounds(values)
    plan = trajectories(nlp, result, p)
    found, replay, book = audit(nlp, result, plan, values, p, bounds)
    # Not the solver's f, which may hold a penalty on gains or on products of contact.
    physical = session.problem.parameters.pack(values)
    kept = feasible(nlp, found)
    costs = trajectory_costs(session.problem, plan.x, plan.u, physical)
    rolled = Rollout(plan.x, plan.u, plan.lam, plan.gap, costs)
    certificate = Certificate("undecided", reason=UNJUDGED)
    idle, span, derivative = float("nan"), 0.0, None
    if kept:
        span = cost_span(session.problem, rolled, physical)
        asked, point = judged_point(session, outcome, rolled, plan.gains)
        given = {**values, "penalty": 0.0}
        certificate = certify(
            asked, point.x, asked.parameter_vector(given), asked.bounds(given), point.lam_g, span
        )
        if certificate.stationarity == "not":
            certificate = replace(certificate, reason=outcome.trace.refused)
        derivative = partial(sensitivity, asked, point, given)
        idle = idle_cost(session, rolled)
    report = evaluate(session.problem, session.step, rolled, values, plan.gains)
    return Solution(
        data=label(nlp, plan, replay, book, outcome, values, report.referee.replay),
        cost=rolled.cost,
        status=status_of(outcome, found, kept, certificate, rolled.cost, idle, span),
        audit=found,
        certificate=certificate,
        referee=referee_findings(report, rolled, session.problem.scales),
        idle_cost=idle,
        stages=outcome.trace.records,
        iterations=outcome.trace.iterations,
        build_s=session.total_build_s,
        solve_s=outcome.trace.seconds,
        record={**record(session, seed), "audit_s": time.perf_counter() - began},
        problem=session.problem,
        values=dict(values),
        gains=plan.gains,
        evaluation_s=outcome.trace.evaluation_s,
        derivative=derivative,
    )


def judged_point(
    session: Session, outcome: Outcome, plan: Rollout, gains: Gains | None
) -> tuple[NLP, Point]:
    """The program that was asked, and an outcome's point in it, with the multipliers there are."""
    nlp, point = session.judging_nlp(), outcome.result.point
    if nlp is outcome.nlp:
        return nlp, point
    if nlp.method == outcome.nlp.method:
        return nlp, Point(translate(point, outcome.nlp, nlp).x)
    if outcome.on_branch is not None:
        return nlp, outcome.on_branch.point
    return nlp, Point(pack_rollout(nlp, plan, gains))


def cost_span(problem: Problem, plan: Rollout, physical: np.ndarray) -> float:
    """What the cost changes by, at most, as all states and inputs move by a characteristic size.

    They move freely, not along a motion, so that no instability enters.
    """
    sizes = problem.scales
    costs = [
        trajectory_costs(problem, plan.x + s * sizes.x, plan.u + s * sizes.u, physical)
        for s in (-1.0, 1.0)
    ]
    return float(np.nan_to_num([np.abs(c - plan.costs).max() for c in costs]).max())


def idle_cost(session: Session, plan: Rollout) -> float:
    """Cost of standing still where the plan starts: the lower one of two ways to do so.

    Either the input before the first is held, and the law makes of it what it makes. Or the states
    stay, where one of the plan's inputs can hold them and the cost wants them elsewhere; the
    holding itself is not counted. NaN where neither can be, or where it breaks constraints that
    the plan keeps.
    """
    return float(np.fmin(_held_cost(session, plan), _still_cost(session, plan)))


def _held_cost(session: Session, plan: Rollout) -> float:
    problem, values = session.problem, session.values
    physical = problem.parameters.pack(values)
    held = np.tile(np.array(problem.limits(physical)[1]).ravel(), (1, problem.N, 1))
    idle, unsolved = roll_on(problem, held, values, session.step, plan.x[:, 0])
    if unsolved is not None or broken_constraints(problem, idle.x, idle.u, physical):
        return float("nan")
    return idle.cost


def _still_cost(session: Session, plan: Rollout) -> float:
    problem, values, N = session.problem, session.values, session.problem.N
    physical = problem.parameters.pack(values)
    before = np.array(problem.limits(physical)[1]).ravel()
    x, u = np.repeat(plan.x[:, :1], N + 1, axis=1), np.tile(before, (len(plan.x), N, 1))
    limit, S = _STILL * problem.scales.x / N, len(x)
    if not all(_holds(session, x[s, 0], plan.u[s], limit) for s in range(S)):
        return float("nan")
    costs = trajectory_costs(problem, x, u, physical)
    still = replace(plan, x=x, u=u, costs=costs)
    wanted = max(_state_slope(problem, x[s, 0], physical) for s in range(S))
    if wanted <= _CONTENT * cost_span(problem, still, physical):
        return float("nan")
    return float("nan") if broken_constraints(problem, x, u, physical) else still.cost


def _state_slope(problem: Problem, x: np.ndarray, physical: np.ndarray) -> float:
    """Most that staying at x (nx,) costs more where one state moves by its size, first order."""
    before = problem.limits(physical)[1]
    stage, end = problem.state_slopes(x, before, 0 * before, physical)
    slopes = np.abs(problem.N * np.array(stage) + np.array(end)).ravel()
    return float((problem.scales.x * slopes).max(initial=0.0))


def _holds(session: Session, x: np.ndarray, inputs: np.ndarray, limit: np.ndarray) -> bool:
    """Whether one of ``inputs`` (N, nu) moves no state of x (nx,) by more than ``limit`` (nx,)."""
    p = session.step.p.pack(session.values)
    start = np.repeat(x[:, None], len(inputs), axis=1)
    after = np.array(session.step.solve.map(len(inputs))(start, inputs.T, p)[0])
    return bool(np.any(np.all(np.abs(after - start) <= limit[:, None], axis=0)))


def referee_findings(report: RefereeReport, plan: Rollout, sizes: Scales) -> RefereeFindings:
    """What a run keeps of the referee's hearing; without geometry there is no referee."""
    referee = report.referee
    nonuniqueness = _undetermined(report.nonuniqueness, sizes)
    if referee.note is None:
        return RefereeFindings(note="no geometry", nonuniqueness=nonuniqueness)
    return RefereeFindings(
        cost=referee.cost,
        gap=float(np.abs(referee.replay.x - plan.x).max()),
        survives=not (report.reasons or report.refined_reasons),
        survives_at_h=not report.reasons,
        reasons=list(report.reasons),
        refined_reasons=list(report.refined_reasons),
        note=referee.note,
        refined_cost=referee.refined_cost,
        refined_note=referee.refined_note,
        penetration=report.planned.penetration,
        between=report.planned.between,
        force_distance=report.planned.force_distance,
        replay_penetration=report.replayed.penetration,
        replay_between=report.replayed.between,
        broken=[one.violation for one in report.broken],
        nonuniqueness=nonuniqueness,
    )


def _undetermined(found: Nonuniqueness | None, sizes: Scales) -> str:
    if found is None:
        return ""
    mu, unit = _SHARP * sizes.mu, found.unit.removeprefix("1")
    return (
        f"the contact forces at step {found.step} are not unique"
        f" ({', '.join(found.contacts)}): from the same state and input, {found.state} can"
        f" also end {found.distance:.2g} {unit}".rstrip()
        + " away; plan with a unique step"
        f" instead: --method multiple-shooting --contact barrier -c mu={mu:.0e}"
    )


def status_of(
    outcome: Outcome, found: Audit, kept: bool, certificate: Certificate, cost: float, idle: float,
    span: float,
) -> Status:  # fmt: skip
    """Turn audit, certificate and, where these find no answer, the solver's word into a status."""
    result = outcome.result
    if result.status is Status.INTERRUPTED:
        return result.status
    if not np.isfinite(cost):
        return Status.DIVERGED
    if not kept:
        return Status.INEXACT if result.ok else result.status
    # A force from afar moves what its exact replay does not: that is smoothing, and no dead end.
    # And where standing still breaks constraints that the plan keeps, the plan is better.
    own = found.state_gap <= _STILL * outcome.nlp.problem.scales.x.max() and np.isfinite(idle)
    blind = found.active_steps == 0 and found.task_gradient < _FLAT and own
    wants = certificate.slope > _CONTENT * span
    if blind or (wants and cost >= idle - _IDLE * abs(idle)):
        return Status.NO_PROGRESS
    if certificate.certified:
        return Status.SOLVED
    if not result.ok:
        return result.status
    return Status.UNDECIDED if certificate.stationarity == "undecided" else Status.NOT_OPTIMAL


def record(session: Session, seed: int) -> dict[str, Any]:
    """Everything that tells how an answer came about, ready for JSON."""
    problem, policy = session.problem, session.policy
    learned = session.law if isinstance(session.law, LearnedLaw) else None
    return {
        "problem": problem.name,
        "contact": session.law.name,
        "contact_settings": session.law.settings(),
        "method": session.method.name,
        "policy": policy.name,
        "policy_settings": asdict(policy),
        "solver": session.solver.name,
        "solver_options": session.solver.options,
        "strategy": session.strategy if session.complementary else None,
        "jit": session.compiled.outcome if session.compiled else None,
        "params": {
            **{name: session.values[name] for name in problem.parameters.names},
            **problem.settings,
        },
        "law_parameters": {name: session.values[name] for name in session.step.p.names
                  if name not in problem.parameters},
        "N": problem.N,
        "learned_at": learned.learned_at(problem.system, session.values) if learned else {},
        "seed": seed,
        "versions": versions(),
        "citation": problem.citation,
        "source": problem.source,
    }  # fmt: skip
