"""Compiled functions handed from one session to the next, where both differ in numbers only.

The session of a point is made as that of any solve is, so that its answer is the same to the last
bit: guess, natural units and each decision that looks at a number are its own. What it does not
build again are functions: of programs, steps, costs and bounds. They have all parameters as inputs
and nothing else from outside, so equal graphs make equal functions.
"""

from __future__ import annotations

import hashlib
import threading
from dataclasses import asdict, replace
from typing import Any

import casadi as ca

from dynamics.contact import ContactLaw, Step
from dynamics.systems import LAW_PREFIX, ParameterTable
from ocp.problem import Problem
from ocp.request import ProblemSource
from ocp.session import Session
from ocp.sweeps.case import Case


class SessionCache:
    """The last session of a worker, whose functions the next one takes over where it can."""

    def __init__(self) -> None:
        self._last: tuple[Any, Session] | None = None
        self._sources: dict[tuple[str, str | None], ProblemSource] = {}

    def session(self, case: Case) -> Session:
        """Build a session; raises as :meth:`~ocp.sweeps.case.Case.session` does."""
        asked = case.problem, case.content
        if asked not in self._sources:
            self._sources[asked] = case.source()
        made = case.session(self._sources[asked])
        told = [asked, structure(made)]
        if self._last is not None and self._last[0] == told:
            _share_functions(self._last[1], made)
        self._last = told, made
        return made


# Dask may do two jobs in one process, in a thread each.
_of_thread = threading.local()


def cached_session(case: Case) -> Session:
    """Build a session by what this thread has kept; raises as :class:`SessionCache` does."""
    if not hasattr(_of_thread, "kept"):
        _of_thread.kept = SessionCache()
    return _of_thread.kept.session(case)


def structure(session: Session) -> list[Any]:
    """All that a session's functions depend on: graphs, sizes and choices, no parameter's value."""
    problem, step = session.problem, session.step
    steps = (step, problem.exact_step, problem.referee_step)
    return [
        [(type(one), _digest(one.relation)) for one in steps],
        _digest(_costs_and_bounds(problem)),
        step.p.names, problem.N, problem.scenarios,
        [pair.kind for pair in problem.system.pairs],
        _settings(session.law, step.p),
        session.method.name, session.policy.name, asdict(session.policy),
        session.solver.name, session.solver.options,
        session.strategy, session.homotopy, session.factor, session.start_value,
        session.compiled is None,
    ]  # fmt: skip


def _costs_and_bounds(problem: Problem) -> ca.Function:
    system, p = problem.system, problem.parameters.vector
    du = ca.SX.sym("du", system.nu) if problem.du is None else problem.du
    constraints = [*problem.path, *problem.terminal]
    parts = [(one.expression, one.lower, one.upper) for one in constraints]
    ends = [*problem.limits(p), *problem.start_limits(p)]
    costs = [problem.stage_cost, problem.terminal_cost]
    held = [*costs, *ends, *(ca.SX(part) for row in parts for part in row), ca.SX(system.h)]
    return ca.Function("problem", [system.x, system.u, du, p], held)


def _digest(function: ca.Function) -> str:
    return hashlib.sha256(function.serialize().encode()).hexdigest()


def _settings(law: ContactLaw, p: ParameterTable) -> list[Any]:
    """The settings of a law that are no parameters of its graphs."""
    found = [
        (key, _settings(value, p) if isinstance(value, ContactLaw) else value)
        for key, value in law.settings().items()
        if LAW_PREFIX + key not in p
    ]
    return [type(law), *found]


def _share_functions(old: Session, new: Session) -> None:
    for one, other in ((old.problem, new.problem), (old.step, new.step),
                       (old.problem.exact_step, new.problem.exact_step),
                       (old.problem.referee_step, new.problem.referee_step)):  # fmt: skip
        _give_functions(one, other)
    _give_programs(old, new)
    for helper in old.helpers.values():
        other = new.helper(helper.law, helper.method)
        _give_functions(helper.step, other.step)
        _give_programs(helper, other)


def _give_functions(old: Problem | Step, new: Problem | Step) -> None:
    # Where a cached property keeps what it made.
    kept = vars(new)
    for name, value in vars(old).items():
        if isinstance(value, ca.Function):
            kept.setdefault(name, value)


def _give_programs(old: Session, new: Session) -> None:
    new.compiled = old.compiled
    for reformulation, nlp in old.nlps.items():
        taken = replace(nlp, problem=new.problem, step=new.step, policy=new.policy, solvers={})
        # A program's scale is part of its compiled solvers.
        if nlp.scale is None and taken.scale is None:
            taken.solvers.update(nlp.solvers)
        new.nlps[reformulation] = taken
