"""Best known costs that the problem files state: solved again with the stated settings, and compared."""

from __future__ import annotations

import functools

from dynamics.contact import Barrier, ContactLaw, Exact
from ocp import Direct, Solution
from ocp.problem.rollout import initial_guesses
from ocp.routes.session import Session
from ocp.solve.judging import judge_outcome
from ocp.solve.solve import new_session
from problems import Golden, get, names, spec

LAWS: dict[str, ContactLaw] = {"exact": Exact(), "barrier mu=1e-3": Barrier(mu=1e-3)}
STATED = [(name, key) for name in names() for key in spec(name).golden]
BETTER = 1e-6
"""Relative gain above which a solution counts as better than the best known one."""


def session_of(name: str, key: str = "exact", **settings: str | float) -> Session:
    """Return a session of the problem at its defaults, under the law called ``key``."""
    return new_session(get(name), LAWS[key], Direct(), settings=settings)


def solved(session: Session, start: int = 0) -> Solution:
    """Return the solution from guess number ``start`` of seed 0."""
    guess = initial_guesses(session.evaluation, start + 1, 0)[start]
    return judge_outcome(session, session.solve(guess=guess), 0)


@functools.cache
def reached(name: str, key: str) -> Solution:
    """Return the solution with the stated settings and guess."""
    golden = spec(name).golden[key]
    return solved(session_of(name, key, **golden.settings), golden.start)


def better(golden: Golden, found: Solution) -> bool:
    """Return whether a solution is certified and costs less than the stated value."""
    return found.success and found.cost < golden.cost - BETTER * abs(golden.cost)


def fault(golden: Golden, found: Solution) -> str:
    """Return what is wrong with a stated value, given the solution with its settings; "" if nothing is."""
    judge = found.certificate
    if better(golden, found):
        return f"{found.cost:.10g} is certified and better: state that"
    if found.cost > golden.cost + golden.tolerance * abs(golden.cost):
        return f"only {found.cost:.10g} was reached"
    if (judge.stationarity, judge.kind) != (golden.stationarity, golden.kind):
        return f"the certificate says {judge.stationarity}, {judge.kind}"
    if found.cost < golden.cost - golden.tolerance * abs(golden.cost):
        return f"{found.cost:.10g} is lower, though not certified"
    return ""
