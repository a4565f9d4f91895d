"""Expensive values that forward step and adjoint share are computed once."""

from __future__ import annotations

import casadi as ca
import numpy as np

from dynamics.batch import open_loop
from dynamics.batch.graphs.hoisting import carry_costly_values
from dynamics.batch.graphs.objective import Costs
from dynamics.batch.graphs.rollout_tapes import ClosedStep, with_carried_values
from dynamics.batch.graphs.tape import tape_of
from dynamics.contact import Barrier
from tests.unit.dynamics.batch.rollout_cases import closed, wall


def pair() -> tuple[ca.Function, ca.Function]:
    x, theta, w, p = (ca.SX.sym(name, 2) for name in ("x", "theta", "w", "p"))
    lam, xbar = ca.SX.sym("lam"), ca.SX.sym("xbar", 2)
    root = ca.sqrt(ca.sumsqr(x) + p[0])
    solved = theta[0] / root
    forward = ca.Function("forward", [x, theta, w, p], [x * solved + w, solved, root])
    # The forward step computes exp(lam) too; only the adjoint computes exp(xbar).
    bars = [xbar * root + ca.exp(xbar[0]) / ca.sqrt(p[0] + ca.sumsqr(x)), lam * xbar]
    return forward, ca.Function("adjoint", [x, theta, w, p, lam, xbar], bars)


def count(fn: ca.Function, op: int) -> int:
    return sum(operation.op == op for operation in tape_of(fn).operations)


def test_values_are_the_same_and_roots_are_gone():
    forward, adjoint = pair()
    longer, lighter = carry_costly_values(forward, adjoint)
    assert count(adjoint, ca.OP_SQRT) == 1
    assert count(lighter, ca.OP_SQRT) == 0
    assert count(lighter, ca.OP_EXP) == 1
    rng = np.random.default_rng(0)
    x, theta, w, p, xbar = (rng.uniform(0.5, 1.0, 2) for _ in range(5))
    x_next, lam, cost = forward(x, theta, w, p)
    again = longer(x, theta, w, p)
    np.testing.assert_allclose(np.array(again[0]), np.array(x_next), rtol=1e-15)
    np.testing.assert_allclose(float(again[1][0]), float(lam), rtol=1e-15)
    np.testing.assert_allclose(float(again[2]), float(cost), rtol=1e-15)
    wanted = adjoint(x, theta, w, p, lam, xbar)
    got = lighter(x, theta, w, p, again[1], xbar)
    for one, other in zip(got, wanted, strict=True):
        np.testing.assert_allclose(np.array(one), np.array(other), rtol=1e-14)


def test_a_contacts_root_is_taken_once_a_step():
    step, stage, terminal = closed(wall(), Barrier(mu=1e-3))
    tapes = with_carried_values(ClosedStep(step, Costs(stage, terminal), open_loop(2, 1)).tapes_with_adjoint)
    assert isinstance(tapes.forward, ca.Function)
    assert count(tapes.forward, ca.OP_SQRT) == 1
    assert count(tapes.adjoint.step, ca.OP_SQRT) == 0
