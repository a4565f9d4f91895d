"""The one entry: a problem, a law, a method, a policy and a solver in, a judged solution out."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from dynamics.contact import ContactLaw, Exact
from ocp.audit import audit, judge, trajectories
from ocp.errors import InputError
from ocp.labelled import label
from ocp.policy import OpenLoop, Policy
from ocp.problem import Problem
from ocp.rollout import trajectory_costs
from ocp.session import Outcome, Session
from ocp.settings import Settings
from ocp.solution import Interrupted, Solution, StageRecord, Status
from ocp.solvers.solver import Solver
from ocp.studies.provenance import versions
from ocp.transcription import Direct, Method
from ocp.transcription.compiled import StageCompiler
from ocp.warm_start import carried_guess, carry

_SPREAD = 0.3


def solve(
    problem: Problem,
    contact: ContactLaw | None = None,
    transcription: Method | None = None,
    policy: Policy | None = None,
    solver: str = "ipopt",
    settings: dict[str, Any] | None = None,
    starts: int = 1,
    seed: int = 0,
    progress: Callable[[StageRecord], None] | None = None,
    start: Solution | None = None,
) -> Solution:
    """Solve ``problem`` and audit the answer.

    ``starts`` > 1 solves from as many guesses, the first the problem's own, the others perturbed
    by seeded noise of 0.3 characteristic units; the best audited answer wins and the others are
    listed in ``Solution.others``.

    ``start`` is a solution of the same problem, at other parameters, on another mesh or horizon,
    under another law or by another method: its trajectories and multipliers are what the solver
    starts at (:func:`~ocp.warm_start.carry`). Where it does not converge from there, the usual
    path is followed with those trajectories as the guess.

    Raises :class:`~ocp.errors.InputError` for settings, names or combinations that cannot be.
    """
    if not 1 <= starts <= 10_000:
        raise InputError(f"starts must be from 1 to 10000, got {starts}")
    session = new_session(problem, contact, transcription, policy, solver, settings)
    if start is not None:
        if starts != 1:
            raise InputError("a start and several starts exclude each other; leave starts at 1")
        found = judged(session, from_solution(session, start, progress), seed)
        origin = start.record.get("hash", "a solution in memory")
        return replace(found, record={**found.record, "from": origin})
    return solve_session(session, starts, seed, progress)


def from_solution(
    session: Session, start: Solution, progress: Callable[[StageRecord], None] | None = None
) -> Outcome:
    """Solve a session from a solution; raises as :func:`~ocp.warm_start.carry` does."""
    nlp = session.nlp_of("product")
    outcome = session.resume(carry(start, nlp, session.values), progress)
    if outcome.finished:
        return outcome
    guess = carried_guess(start, session.problem, session.values)
    again = session.solve(progress=progress, guess=guess)
    again.trace.absorb(outcome.trace)
    return again


def new_session(
    problem: Problem,
    contact: ContactLaw | None = None,
    transcription: Method | None = None,
    policy: Policy | None = None,
    solver: str = "ipopt",
    settings: dict[str, Any] | None = None,
) -> Session:
    """Build what a solve, or a whole study, needs once."""
    chosen = Settings.read(settings or {})
    return Session(
        problem,
        contact or Exact(),
        transcription or Direct(),
        policy or OpenLoop(),
        Solver(solver, chosen.options),
        chosen.strategy,
        chosen.homotopy,
        chosen.factor,
        chosen.start,
        StageCompiler() if chosen.jit else None,
    )


def solve_session(
    session: Session,
    starts: int = 1,
    seed: int = 0,
    progress: Callable[[StageRecord], None] | None = None,
) -> Solution:
    """Solve a session from one or several guesses.

    Raises :class:`~ocp.solution.Interrupted`, with the best answer so far, where Ctrl-C falls
    between several starts.
    """
    solutions: list[Solution] = []
    try:
        for guess in guesses(session, starts, seed):
            outcome = session.solve(progress=progress, guess=guess)
            solutions.append(judged(session, outcome, seed))
    except KeyboardInterrupt as stop:
        if not solutions:
            raise
        raise Interrupted(best_of(solutions)) from stop
    return solutions[0] if starts == 1 else best_of(solutions)


def best_of(solutions: list[Solution]) -> Solution:
    """Return the best audited answer, with the others listed and the work of all counted."""
    best = min(solutions, key=rank)
    others = [
        {
            "start": index,
            "status": found.status.label,
            "cost": found.cost,
            "exact_cost": found.audit.exact_cost,
            "iterations": found.iterations,
            "chosen": found is best,
        }
        for index, found in enumerate(solutions)
    ]
    iterations = sum(found.iterations for found in solutions)
    spent = {
        key: sum(getattr(found, key) for found in solutions) for key in ("solve_s", "evaluation_s")
    }
    return replace(best, others=others, iterations=iterations, **spent)


def rank(found: Solution) -> tuple[int, float]:
    """Order answers: audited ones first, then by cost."""
    order = {Status.SOLVED: 0, Status.NO_PROGRESS: 1}
    return order.get(found.status, 2), found.cost if np.isfinite(found.cost) else np.inf


def guesses(session: Session, starts: int, seed: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the problem's own guess and perturbed ones, each from its own stream of the seed."""
    problem = session.problem
    physical = np.array([session.values[name] for name in problem.parameters.names])
    X, U = problem.initial_guess(physical)
    found = [(X, U)]
    for stream in np.random.SeedSequence(seed).spawn(starts - 1):
        noise = np.random.default_rng(stream)
        size_x, size_u = problem.reference.x, problem.reference.u
        shaken = X + _SPREAD * size_x * noise.standard_normal(X.shape)
        shaken[0] = X[0]
        found.append((shaken, U + _SPREAD * size_u * noise.standard_normal(U.shape)))
    return found


def judged(session: Session, outcome: Outcome, seed: int) -> Solution:
    """Audit an outcome, label it, and say what came of it."""
    began = time.perf_counter()
    nlp, result = outcome.nlp, outcome.result
    values = session.values
    p, bounds = nlp.parameter_vector(values), nlp.bounds(values)
    plan = trajectories(nlp, result, p)
    found, replay, book = audit(nlp, result, plan, values, p, bounds)
    status = judge(nlp, result, found, outcome.finished)
    # Not the solver's f, which may hold a penalty on gains or on products of contact.
    physical = np.array([values[name] for name in session.problem.parameters.names])
    data = label(nlp, plan, replay, book, outcome, values)
    return Solution(
        data=data,
        cost=float(trajectory_costs(session.problem, plan.x, plan.u, physical).mean()),
        status=status,
        audit=found,
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
