"""Sessions of requests in a worker, which reuse compiled functions.

The session of a sweep's point is built like the session of a single solve, so that both have bitwise the same
solution. Only compiled functions (of programs, steps, costs and bounds) are reused between points. Parameters
are inputs of these functions, so that points that differ in parameters alone share them.
"""

from __future__ import annotations

import hashlib
import threading
from dataclasses import asdict, replace
from typing import Any

import casadi as ca

from dynamics.contact import ContactLaw, Step
from dynamics.systems import LAW_PREFIX, ParameterTable
from ocp.problem.problem import Problem
from ocp.routes.session import Session
from ocp.solve.request import ProblemSource
from ocp.solve.solve_request import SolveRequest


class SessionCache:
    """Cache of a worker's last session, whose compiled functions the next session reuses if possible."""

    def __init__(self) -> None:
        self._last: tuple[Any, Session] | None = None
        self._sources: dict[tuple[str, str | None], ProblemSource] = {}

    def session(self, request: SolveRequest) -> Session:
        """Build a session of ``request`` and cache it; raises the errors of :meth:`SolveRequest.session`."""
        origin = request.problem, request.content
        if origin not in self._sources:
            self._sources[origin] = request.source()
        session = request.session(self._sources[origin])
        identity = [origin, structure(session)]
        if self._last is not None and self._last[0] == identity:
            _share_functions(self._last[1], session)
        self._last = identity, session
        return session


# The state is local to a thread, since Dask may run two jobs in one process, each in its own thread.
_thread_state = threading.local()


def cached_session(request: SolveRequest) -> Session:
    """Build a session of ``request`` with this thread's cache; raises the errors of :class:`SessionCache`."""
    if not hasattr(_thread_state, "cache"):
        _thread_state.cache = SessionCache()
    return _thread_state.cache.session(request)


def structure(session: Session) -> list[Any]:
    """Return everything on which a session's compiled functions depend: graphs, sizes and choices, no parameters."""
    problem, step = session.problem, session.step
    steps = (step, problem.exact_step, problem.referee_step)
    return [
        [(type(graph), _digest(graph.relation)) for graph in steps],
        _digest(_costs_and_bounds(problem)),
        step.p.names,
        problem.N,
        problem.scenarios,
        [pair.kind for pair in problem.system.pairs],
        _fixed_settings(session.law, step.p),
        session.method.name,
        session.policy.name,
        asdict(session.policy),
        session.solver.name,
        session.solver.options,
        session.strategy,
        session.homotopy,
        session.factor,
        session.homotopy_start,
        session.compiled is None,
    ]


def _costs_and_bounds(problem: Problem) -> ca.Function:
    p = problem.parameters.vector
    constraints = [*problem.path, *problem.terminal]
    bounded = [(constraint.expression, constraint.lower, constraint.upper) for constraint in constraints]
    limits = [*problem.limits(p), *problem.start_limits(p)]
    costs = [problem.stage_cost, problem.terminal_cost]
    h = ca.SX(problem.system.h)
    outputs = [*costs, *limits, *(ca.SX(expression) for row in bounded for expression in row), h]
    return ca.Function("problem", problem.symbols, outputs)


def _digest(function: ca.Function) -> str:
    return hashlib.sha256(function.serialize().encode()).hexdigest()


def _fixed_settings(law: ContactLaw, p: ParameterTable) -> list[Any]:
    """Return a law's type, and the settings of the law that are not parameters of its graphs."""
    fixed = [
        (key, _fixed_settings(value, p) if isinstance(value, ContactLaw) else value)
        for key, value in law.settings().items()
        if LAW_PREFIX + key not in p
    ]
    return [type(law), *fixed]


def _share_functions(old: Session, new: Session) -> None:
    for old_owner, new_owner in (
        (old.problem, new.problem),
        (old.step, new.step),
        (old.problem.exact_step, new.problem.exact_step),
        (old.problem.referee_step, new.problem.referee_step),
    ):
        _copy_functions(old_owner, new_owner)
    _copy_programs(old, new)
    for old_session in old.sub_sessions.values():
        new_owner = new.sub_session(old_session.law, old_session.method)
        _copy_functions(old_session.step, new_owner.step)
        _copy_programs(old_session, new_owner)


def _copy_functions(old: Problem | Step, new: Problem | Step) -> None:
    # The instance's dictionary contains the values of cached properties.
    cached = vars(new)
    for name, value in vars(old).items():
        if isinstance(value, ca.Function):
            cached.setdefault(name, value)


def _copy_programs(old: Session, new: Session) -> None:
    new.compiled = old.compiled
    for reformulation, nlp in old.nlps.items():
        program = replace(nlp, problem=new.problem, step=new.step, policy=new.policy, solvers={})
        # A program's scale is part of its compiled solvers.
        if nlp.scale is None and program.scale is None:
            program.solvers.update(nlp.solvers)
        new.nlps[reformulation] = program
