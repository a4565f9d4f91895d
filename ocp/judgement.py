"""Three judges of one outcome: the audit with the certificate, the referee, and the solver's word.

Owns how they are put together into one status; each of them knows nothing of the others.
"""

from __future__ import annotations

import time
from dataclasses import asdict
from typing import Any

import numpy as np

from ocp.audit import Trajectories, audit, feasible, trajectories
from ocp.certificate import Certificate, certify
from ocp.errors import NotConverged
from ocp.findings import Audit
from ocp.labelled import label
from ocp.landing import embedded
from ocp.rollout import Rollout, roll_out, trajectory_costs
from ocp.session import Outcome, Session
from ocp.solution import Solution, Status
from ocp.solvers.homotopy import translate
from ocp.studies.provenance import versions

_FLAT = 1e-7
_IDLE = 1e-6
"""Relative gain over standing still below which nothing was achieved."""


def judged(session: Session, outcome: Outcome, seed: int) -> Solution:
    """Audit an outcome, certify and referee it, label it, and say what came of it."""
    began = time.perf_counter()
    nlp, result = outcome.nlp, outcome.result
    values = session.values
    p, bounds = nlp.parameter_vector(values), nlp.bounds(values)
    plan = trajectories(nlp, result, p)
    found, replay, book = audit(nlp, result, plan, values, p, bounds)
    # Not the solver's f, which may hold a penalty on gains or on products of contact.
    physical = np.array([values[name] for name in session.problem.parameters.names])
    cost = float(trajectory_costs(session.problem, plan.x, plan.u, physical).mean())
    kept = feasible(nlp, found)
    certificate = certificate_of(session, outcome, plan) if kept else Certificate(
        "undecided", reason="the point is not feasible"
    )  # fmt: skip
    idle = idle_cost(session, plan) if kept else float("nan")
    return Solution(
        data=label(nlp, plan, replay, book, outcome, values),
        cost=cost,
        status=status_of(outcome, found, kept, certificate, cost, idle),
        audit=found,
        certificate=certificate,
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
    )


def certificate_of(session: Session, outcome: Outcome, plan: Trajectories) -> Certificate:
    """Certify an outcome's point for the problem that was asked, see :func:`certify`."""
    nlp, point = session.judging_nlp(), outcome.result.point
    values = {**session.values, "penalty": 0.0}
    p, bounds = nlp.parameter_vector(values), nlp.bounds(values)
    if nlp is outcome.nlp:
        return certify(nlp, point.x, p, bounds, point.lam_g)
    if nlp.method == outcome.nlp.method:
        return certify(nlp, translate(point, outcome.nlp, nlp).x, p, bounds)
    rolled = Rollout(plan.x, plan.u, plan.lam, plan.gap, np.zeros(0))
    return certify(nlp, embedded(nlp, rolled, plan.gains), p, bounds)


def idle_cost(session: Session, plan: Trajectories) -> float:
    """Cost under the law of holding the input before the first from where the plan starts.

    NaN where that motion cannot be stepped through.
    """
    problem, values = session.problem, session.values
    physical = np.array([values[name] for name in problem.parameters.names])
    held = np.tile(np.array(problem.limits(physical)[1]).ravel(), (1, problem.N, 1))
    try:
        return roll_out(problem, held, values, session.step, plan.x[:, 0]).cost
    except NotConverged:
        return float("nan")


def status_of(
    outcome: Outcome, found: Audit, kept: bool, certificate: Certificate, cost: float, idle: float
) -> Status:
    """Turn audit, certificate and, where these find no answer, the solver's word into a status."""
    result, system = outcome.result, outcome.nlp.problem.system
    if not kept:
        return Status.INEXACT if result.ok else result.status
    blind = found.active_steps == 0 and found.task_gradient < _FLAT and system.nlam > 0
    wants = certificate.slope > _IDLE * abs(cost)
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
        "knobs": {name: session.values[name] for name in session.step.p.names
                  if name not in problem.parameters},
        "N": problem.N,
        "seed": seed,
        "versions": versions(),
        "citation": problem.citation,
    }  # fmt: skip
