"""The workbench's side of every benchmark: problems, sessions and guesses."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from dynamics.contact import ContactLaw
from dynamics.systems import ParameterTable, lcs
from ocp.problem.problem import Problem, Scaling
from ocp.routes.session import Session
from ocp.solve.solve import new_session
from problems import get
from tests.benchmarks.ocp.models import random_matrices
from tests.benchmarks.ocp.opti_peer import Guess

FIVE = ("wall-1d", "push-1d", "push-disc", "ball-bounce", "cart-walls")
LCS = "lcs-10-3-6"


def problem(name: str, N: int | None = None) -> Problem:
    """Build a named problem, or the random LCS, at a horizon."""
    if name == LCS:
        return random_lcs(N or 100)
    return get(name, **({} if N is None else {"N": N}))


def random_lcs(N: int, seed: int = 7) -> Problem:
    """Return the LCS of :func:`models.random_matrices` as a problem of the workbench."""
    m = random_matrices(seed)
    system = lcs(LCS, A=m.A, B=m.B, C=m.C, D=m.D, E=m.E, F=m.F, d=m.d)
    x, u = system.x, system.u
    return Problem(
        name=LCS,
        system=system,
        N=N,
        stage_cost=0.1 * ca.sumsqr(x) + 0.01 * ca.sumsqr(u),
        terminal_cost=10 * ca.sumsqr(x),
        x0=ca.SX(ca.DM(m.x0)),
        parameters=ParameterTable(),
        u_lower=-5.0,
        u_upper=5.0,
        scaling=Scaling(impulse=1.0, gap=0.1),
    )


def session(name: str, law: ContactLaw, N: int | None = None, **settings: Any) -> Session:
    """Return a session with direct transcription, with everything but the NLP built."""
    return new_session(problem(name, N), law, settings=settings)


def same_guess(made: Session) -> Guess:
    """Return the initial guess of the workbench's solve, as blocks for the peer."""
    nlp = made.nlp_of("product")
    blocks = nlp.variables.unpack(made.first_point(nlp).x)
    x0 = nlp.data.unpack(nlp.parameter_vector(made.values)[len(nlp.names) :])["x0"]
    x = np.concatenate([x0, blocks["x"][0]])
    return Guess(x, blocks["u"][0], blocks["lam"][0], blocks["gap"][0])
