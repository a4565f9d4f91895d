"""The certificate's tolerance grows neither with the horizon nor with one steep entry of the gradient."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from dynamics.contact import Exact
from dynamics.systems import Parameter, ParameterTable, signals, time_stepping
from ocp.judge.certificate import Certificate, certify
from ocp.mpcc import MPCC
from ocp.mpcc.programs import MPCCProgram, programs_of
from ocp.problem.policy import OpenLoop
from ocp.problem.problem import Problem, Scaling
from ocp.routes.session import Session
from ocp.transcription import Direct

OFF = 3e-3
"""Distance of an entry from its optimum; the remaining gain is nine times the smallest that counts, and the
slope of the cost, 6e-3, is 4 % of what 1e-4 of a sum over 1,600 entries would allow."""


def program_of(mpcc: MPCC, start: np.ndarray) -> MPCCProgram:
    program = programs_of(mpcc, np.zeros(0), start)("none")
    assert isinstance(program, MPCCProgram)
    return program


def certificate_of(mpcc: MPCC, x: np.ndarray) -> Certificate:
    program, values = program_of(mpcc, x), {"route.penalty": 0.0, "route.relaxation": 0.0}
    p, bounds = program.parameter_vector(values), program.bounds(values)
    return certify(program, program.extended(x), p, bounds)


def prices(N: int, price: float = 1.0) -> MPCC:
    """Return the problem ``min price sum_k u_k + (w - 1)²`` with ``u_k >= 1``."""
    u, w = ca.SX.sym("u", N), ca.SX.sym("w")
    lower = np.append(np.ones(N), -np.inf)
    none = ca.SX(0, 1)
    return MPCC(ca.vertcat(u, w), price * ca.sum1(u) + (w - 1) ** 2, none, none, lbx=lower)


@pytest.mark.parametrize("N", [1, 10, 160, 1600])
def test_a_sum_over_many_bounds_hides_no_move(N: int) -> None:
    """At w = 1.003 a move of 3e-3 gains 9e-6, however much the N entries at their bounds cost."""
    off, at = np.append(np.ones(N), 1 + OFF), np.ones(N + 1)
    assert certificate_of(prices(N), off).stationarity == "not"
    assert certificate_of(prices(N), at).certified


def test_the_tolerance_does_not_grow_with_the_sum() -> None:
    few, many = (certificate_of(prices(N), np.ones(N + 1)) for N in (10, 1600))
    assert many.tolerance == pytest.approx(few.tolerance, rel=1e-9)
    assert many.slope > 100 * few.slope


def steep(price: float) -> MPCC:
    """Return a problem in which one entry at its bound has a large price."""
    z, a = ca.SX.sym("z"), ca.SX.sym("a")
    none = ca.SX(0, 1)
    return MPCC(ca.vertcat(z, a), price * z + (a - 1) ** 2, none, none, lbx=[0, -np.inf])


@pytest.mark.parametrize("price", [1.0, 1e4, 1e8, 1e12])
def test_one_steep_entry_hides_no_move(price: float) -> None:
    off, at = np.array([0.0, 1 + OFF]), np.array([0.0, 1.0])
    assert certificate_of(steep(price), off).stationarity == "not"
    found = certificate_of(steep(price), at)
    assert found.certified
    assert found.tolerance <= 10 * certificate_of(steep(1.0), at).tolerance


@pytest.mark.parametrize("constant", [0.0, 1e6, -1e10])
def test_a_constant_hides_no_move(constant: float) -> None:
    x = ca.SX.sym("x")
    mpcc = MPCC(x, (x - 1) ** 2 + constant, ca.SX(0, 1), ca.SX(0, 1))
    assert certificate_of(mpcc, np.array([1 + OFF])).stationarity == "not"
    assert certificate_of(mpcc, np.array([1.0])).certified


def carried(N: int) -> Session:
    """Return a session of ``min sum_k u_k + (x_N - 1)²``, in which the other input is the velocity."""
    table = ParameterTable([Parameter("h", 1.0 / N, "s")])
    system = time_stepping(
        "carried",
        states=signals("x [m]; v [m/s]"),
        inputs=signals("u [N]; w [m/s]"),
        contacts=(),
        h=table["h"],
        mass=1.0,
        impulse=lambda q, v, u: u[1] - v,
        distance=lambda q: ca.SX(0, 1),
        parameters=table,
    )
    u, x = system.u, system.x
    problem = Problem(
        "carried",
        system,
        N,
        u[0],
        (x[0] - 1) ** 2,
        ca.SX([0, 1]),
        table,
        u_lower=ca.SX([1, -10]),
        u_upper=ca.SX([2, 10]),
        scaling=Scaling(impulse=1, gap=1, x=1, u=1),
    )
    return Session(problem, Exact(), Direct(), OpenLoop())


@pytest.mark.parametrize("N", [10, 100, pytest.param(1600, marks=pytest.mark.slow)])
def test_a_horizon_hides_no_move(N: int) -> None:
    """With w = 1 in all steps x_N is 1; with w = 1.01 it is 0.01 too large."""
    session = carried(N)
    nlp = session.nlp_of("none")
    p, bounds = nlp.parameter_vector(session.values), nlp.bounds(session.values)

    def judged(speed: float) -> Certificate:
        states = np.column_stack([speed * np.arange(N + 1) / N, np.full(N + 1, speed)])
        states[0] = [0, 1]
        inputs = np.tile([1.0, speed], (N, 1))
        blocks = {"x": states[None, 1:], "u": inputs[None], "x0": states[None, :1]}
        x = nlp.variables.pack({k: v for k, v in blocks.items() if k in nlp.variables})
        return certify(nlp, x, p, bounds)

    assert judged(1.0).certified
    assert judged(1.01).stationarity == "not"
