"""Equations of stationary points with a fixed active set: their derivatives, solutions, margins and multipliers."""

from __future__ import annotations

import numpy as np
import pytest

from dynamics.contact import Exact
from ocp import Direct
from ocp.judge.kkt import Held, KKTCurve, regular_curve
from ocp.problem.problem import Problem
from ocp.programs.program import Program
from ocp.programs.solver import Point
from ocp.solve.solve import new_session
from tests.unit.ocp.cases import directions, numerical, point, session
from tests.unit.ocp.continuation.test_tracking import R, between_walls

SIZE = 10.0
"""Characteristic size of all quantities, which differs from 1."""


def off_curve(seed: int) -> tuple[KKTCurve, np.ndarray]:
    """Return a curve in the mass of a pushed disc, with nonlinear costs and constraints, and coordinates off it."""
    found = session("open-loop", "direct")
    program, rng = found.nlp_of("product"), np.random.default_rng(seed)
    x, y = point(found, seed, 0.1), rng.normal(size=program.m)
    finite = np.isfinite(program.bounds(found.values)["lbg"])
    held = Held(-np.eye(1, program.n, 3).ravel(), np.where(rng.random(program.m) < 0.7, 1.0 - 2 * finite, 0.0))
    curve = KKTCurve(program, found.values, "M", 2.0, Point(x), y, held)
    return curve, curve.start


@pytest.mark.parametrize("seed", [0, 1])
def test_the_matrix_is_the_derivative_of_the_equations(seed: int) -> None:
    curve, v = off_curve(seed)
    along = directions(v.size, seed, 3)
    np.testing.assert_allclose(curve.matrix(v) @ along, numerical(curve.equations, v, along), atol=1e-8)


def test_equations_are_those_of_the_lagrangian_and_of_held_rows() -> None:
    """They are the derivatives of ``f + y' g`` over a size, by the scale of the cost, and the held rows' slack."""
    curve, v = off_curve(0)
    program, (x, y), (p, bounds) = curve.program, curve.primal_dual(v), curve.problem_data(v[-1])
    assert v[-1] * 2.0 == curve.values["M"]
    np.testing.assert_allclose(x[curve.free], v[: curve.nx] * curve.sizes[curve.free])
    assert np.all(y[~curve.acting] == 0) and np.all(y[curve.acting] != 0)

    def lagrangian(shift: np.ndarray) -> np.ndarray:
        f, g = program.values(x + shift * program.sizes(x), p)
        return np.array([(f + y @ g) / curve.scale])

    along = np.eye(program.n)[:, ::8]
    slopes = numerical(lagrangian, np.zeros(program.n), along).ravel()
    np.testing.assert_allclose(curve.lower_slopes(v)[::8], slopes, atol=1e-8)
    jacobian = program.first_derivatives(point(session("open-loop", "direct"), 0, 0.1), p)[2].toarray()
    largest = np.maximum(np.abs(jacobian * curve.sizes).max(axis=1), 1e-12)
    ends = np.where(np.isfinite(bounds["lbg"]), bounds["lbg"], bounds["ubg"])
    slack = (program.values(x, p)[1] - ends) / largest
    np.testing.assert_allclose(curve.equations(v)[curve.nx :], slack[curve.acting], atol=1e-12)


def walls() -> tuple[Problem, Program, dict[str, float]]:
    """Return ``min r u² + (x+ - theta)²`` between walls at -1 and 1, solved by u = clip(theta / (1 + r), -1, 1)."""
    problem = between_walls(lambda u, _: R * u**2, lambda x, theta: (x - theta) ** 2, size=SIZE)
    found = new_session(problem, Exact(), Direct())
    return problem, found.nlp_of("none"), {**found.values, "theta": 0.6}


def solution(program: Program, theta: float) -> np.ndarray:
    """Return the variables at the solution: state, input, impulses, and the gaps 1 + u and 1 - u of both walls."""
    u = float(np.clip(theta / (1 + R), -1, 1))
    blocks = {"x": [[[u]]], "u": [[[u]]], "lam": np.zeros((1, 1, 2)), "gap": [[[1 + u, 1 - u]]]}
    return program.variables.pack({name: np.array(value) for name, value in blocks.items()})


def test_a_curve_is_the_closed_form_of_the_solution() -> None:
    _, program, values = walls()
    curve, v = regular_curve(program, Point(solution(program, 0.6)), values, "theta", 3.0)
    assert curve.curvature(v) == 0
    for theta in (-1.2, 0.3, 1.4):
        moved = curve.corrected_point(v, theta / 3.0)
        assert moved is not None
        ended, cost, _ = curve.solver_point(moved)
        np.testing.assert_allclose(ended.x, solution(program, theta), atol=1e-9)
        assert cost == pytest.approx(R * theta**2 / (1 + R))
    per_theta = curve.tangent(v)[: curve.nx] * curve.sizes[curve.free] / 3.0
    rate = (solution(program, 0.7) - solution(program, 0.6)) / 0.1
    np.testing.assert_allclose(per_theta, rate[curve.free], atol=1e-9)


def test_multipliers_at_a_point_balance_the_gradients() -> None:
    """``grad f + J' lam_g + lam_x = 0``, and a held impulse resists with its wall's multiplier."""
    _, program, values = walls()
    for theta in (0.6, 2.4):
        curve, v = regular_curve(program, Point(solution(program, theta)), {**values, "theta": theta}, "theta", 3.0)
        ended, _, _ = curve.solver_point(v)
        gradient, _, jacobian = program.first_derivatives(ended.x, curve.problem_data(v[-1])[0])
        np.testing.assert_allclose(gradient + jacobian.T @ ended.lam_g + ended.lam_x, 0.0, atol=1e-8)
        assert np.abs(ended.lam_x).max() > (0.1 if theta > 1 + R else -1)


def test_margins_are_slacks_of_free_ends_and_multipliers_of_held_ones() -> None:
    """At theta = 0.6, u = 0.4 the gaps are 1.4 and 0.6, over a size of 10; members of decided pairs have no margin."""
    _, program, values = walls()
    curve, v = regular_curve(program, Point(solution(program, 0.6)), values, "theta", 3.0)
    lower = curve.margins(v)[: program.n]
    gaps, impulses = program.pairs[::-1] if curve.held.x[program.pairs[0]].all() else program.pairs
    np.testing.assert_allclose(lower[gaps], [0.14, 0.06])
    assert np.all(lower[impulses] == np.inf)
    assert np.all(curve.margins(v)[2 * program.n :] == np.inf), "equations never change"


def test_an_end_is_held_and_freed() -> None:
    held = Held(np.array([0.0, -1.0]), np.array([1.0, 0.0, 0.0]))
    ends = {0: False, 1: True, 2: False, 5: False, 7: True}
    assert {end: held.holds_end(end) for end in ends} == ends
    for end in ends:
        toggled = held.toggle_end(end)
        assert toggled.holds_end(end) != held.holds_end(end)
    np.testing.assert_array_equal(held.toggle_end(2).x, [1, -1])
    np.testing.assert_array_equal(held.toggle_end(8).g, [1, 1, 0])
