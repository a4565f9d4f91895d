"""Quasi-dynamic steps with friction are convex QPs: the path solver agrees with CasADi's ``conic``.

``min 1/2 dq' P dq - b' dq  s.t.  phi + (J_n ± friction J_t) dq >= 0``, Suh et al. 2023, eq. 13.
"""

from __future__ import annotations

import functools

import casadi as ca
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import problems
from dynamics.contact import Exact, Step
from ocp.problem.problem import Problem


@functools.cache
def closed(name: str) -> tuple[Problem, Step]:
    problem = problems.get(name)
    return problem, Exact().close(problem.system)


@functools.cache
def qp_of(name: str) -> tuple[ca.Function, ca.Function]:
    """Return the function ``(x, u, p) -> (P, b, A, phi)`` of the QP in dq, and its solver."""
    problem, _ = closed(name)
    system = problem.system
    dq = ca.SX.sym("dq", system.nx)
    at = [system.x_next, system.lam]
    residual, gap = ca.substitute([system.residual, system.gap], at, [system.x + dq, ca.SX.zeros(system.nlam)])
    P, A = ca.jacobian(residual, dq), ca.jacobian(gap, dq)
    still = [ca.substitute(part, dq, ca.SX.zeros(system.nx)) for part in (residual, gap)]
    given = [system.x, system.u, problem.parameters.vector]
    data = ca.Function("qp", given, [ca.densify(v) for v in (P, -still[0], A, still[1])])
    shapes = {"h": data.sparsity_out(0), "a": data.sparsity_out(2)}
    options = {"print_iter": False, "print_header": False, "print_info": False, "error_on_fail": False}
    return data, ca.conic("step", "qrqp", shapes, options)


@pytest.mark.cheap_cases("planar-hand")
@pytest.mark.parametrize("name", ["planar-push", "planar-hand"])
@settings(max_examples=20, deadline=None)
@given(
    shift=st.lists(st.floats(-0.15, 0.15), min_size=7, max_size=7),
    command=st.lists(st.floats(-0.2, 0.2), min_size=4, max_size=4),
)
def test_the_exact_step_is_the_qps_minimum(name, shift, command):
    problem, step = closed(name)
    p = problem.parameters.values
    x = problem.initial_states(p)[0] + np.array(shift)[: problem.system.nx]
    u = np.array(problem.limits(p)[1]).ravel() + np.array(command)[: problem.system.nu]
    data, solver = qp_of(name)
    P, b, A, phi = data(x, u, p)
    x_next, lam, _, error = (np.array(v).ravel() for v in step.solve(x, u, step.p.values))
    moved = x_next - x
    assert error.max() < 1e-9
    # The step satisfies the QP's optimality conditions: stationary, feasible, complementary.
    np.testing.assert_allclose(np.array(P @ moved - b - A.T @ lam), 0, atol=1e-9)
    left = np.array(phi + A @ moved).ravel()
    assert min(left.min(), lam.min()) > -1e-9
    assert np.abs(left * lam).max() < 1e-9
    found = solver(h=P, g=-b, a=A, lba=-phi, uba=np.inf)
    # On a few degenerate QPs the solver fails, or reports a solution that violates the constraints.
    dq = np.array(found["x"]).ravel()
    assume(solver.stats()["success"] and float(ca.mmin(phi + A @ dq)) > -1e-7)
    np.testing.assert_allclose(moved, dq, atol=1e-6)
