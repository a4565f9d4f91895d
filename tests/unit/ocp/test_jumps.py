"""Costs and constraints that jump are told from those with kinks, and the verdict says so."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from ocp import solve
from ocp.judges.verdict import jumps, jumps_of
from ocp.problem import Constraint
from problems import get, names

X = ca.SX.sym("x", 2)
A, B = X[0], X[1]
SIZES = np.array([1.0, 30.0])
JUMPS = {
    "floor": ca.floor(A), "ceil": B * ca.ceil(3 * A), "sign": ca.sign(A - B),
    "<": ca.if_else(A > 0.1, A, A + 1e-3), "<=": (A >= B) * 1.0, "fmod": ca.fmod(A, 2),
    "remainder": ca.remainder(B, 2), "copysign": ca.copysign(3, A), "==": ca.if_else(A == 0, 1, 0),
}  # fmt: skip
KINKS = {
    "fabs": ca.fabs(A), "fmax": ca.fmax(A, B), "huber": ca.if_else(
        ca.fabs(A) < 1, A**2 / 2, ca.fabs(A) - 0.5),
    "sign": A * ca.sign(A), "hinge": ca.if_else(A > B, A - B, 0) ** 2, "smooth": ca.tanh(A * B),
    "saw": ca.fabs(A - 2 * ca.floor(A / 2 + 0.5)),
}  # fmt: skip


@pytest.mark.parametrize("operation", JUMPS)
def test_what_jumps_is_named(operation):
    assert operation in jumps(ca.SX(JUMPS[operation]), X, SIZES)


@pytest.mark.parametrize("kind", KINKS)
def test_what_is_continuous_does_not_jump(kind):
    assert jumps(KINKS[kind], X, SIZES) == []


@pytest.mark.parametrize("name", names())
def test_no_named_problem_jumps(name):
    assert jumps_of(get(name)) == ()


def test_the_verdict_of_a_cost_that_jumps_is_amber():
    """A rounded term beside the cost is flat almost everywhere, so the certificate stands."""
    plain = get("push-1d", N=3)
    stairs = plain.stage_cost + 1e-6 * ca.floor(plain.system.x[0])
    found = solve(replace(plain, stage_cost=stairs))
    assert found.success
    assert "certificate holds only between jumps" in found.verdict
    assert found.grade == "certified"
    smooth = solve(plain)
    assert "jumps" not in smooth.verdict and smooth.grade == "survives"


def test_constraints_count_and_parameters_do_not():
    plain = get("push-1d", N=3)
    limited = replace(plain, path=[Constraint("stairs", ca.ceil(plain.system.x[0]), -5, 5)])
    assert jumps_of(limited) == ("ceil in stairs",)
    rounded = plain.stage_cost + ca.floor(plain.parameters.vector[0])
    assert jumps_of(replace(plain, stage_cost=rounded)) == ()
