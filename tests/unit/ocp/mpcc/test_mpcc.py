"""Complementarity problems stated in CasADi: textbook examples, parameters, bad input."""

from __future__ import annotations

import re
import textwrap
from itertools import product
from typing import Any

import casadi as ca
import numpy as np
import pytest

import ocp.mpcc
from ocp.errors import InputError
from ocp.mpcc import MPCC, solve, solving
from ocp.mpcc.programs import programs_of
from ocp.programs.solver import Point, Result, Status
from ocp.routes.branches import Branches
from ocp.routes.pieces import polish
from tests.benchmarks.mpcc import scholtes_peer
from tests.benchmarks.mpcc.switching import instances
from tests.unit.ocp.mpcc.mpcc_cases import follower_of, symbols


def test_the_example_of_the_documentation_is_15_lines_and_right(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The follower's solution is min(x, 1); the leader's best x is 2, which costs (1 - 3)²."""
    text = textwrap.dedent(re.split(r"::\n\n", ocp.mpcc.__doc__ or "")[1])
    scope: dict[str, Any] = {}
    exec(text, scope)
    assert len([line for line in text.splitlines() if line.strip()]) == 15
    solution = scope["solution"]
    assert solution.success
    assert solution.x == pytest.approx([2, 1, 1], abs=1e-6)
    assert solution.f == pytest.approx(4, abs=1e-6)
    assert "B-stationary" in capsys.readouterr().out


def bilevel(p: ca.SX) -> MPCC:
    x, (a, b, s) = symbols(3)
    return MPCC(x, (a - 2) ** 2 + (b - 3) ** 2, s, p - b, g=b - a + s, p=p)


@pytest.mark.parametrize(("p", "x", "cost"), [(1.0, [2, 1], 4.0), (5.0, [2.5, 2.5], 0.5), (-1.0, [2, -1], 16.0)])
def test_parameters(p: float, x: list[float], cost: float) -> None:
    """The follower's solution is min(x, p); the leader's best x is 2 for p < 2 and 2.5 for p > 2.5."""
    solution = solve(bilevel(ca.SX.sym("p")), p=[p])
    assert solution.success
    assert solution.x[:2] == pytest.approx(x, abs=1e-6)
    assert solution.f == pytest.approx(cost, abs=1e-6)


def test_scheel_and_scholtes_example_3() -> None:
    """The solution of ``min z1 + z2 - z0`` is the origin, B-stationary but not strongly stationary."""
    z, (z0, z1, z2) = symbols(3)
    g = ca.vertcat(z0 - 4 * z1, z0 - 4 * z2)
    solution = solve(MPCC(z, z1 + z2 - z0, z1, z2, g=g, lbg=-np.inf, ubg=0.0), x0=[1.0, 1.0, 0.5])
    assert solution.success
    assert solution.certificate.kind != "S"
    assert solution.x == pytest.approx([0, 0, 0], abs=1e-6)


def test_a_saddle_that_complementarity_makes_a_minimum() -> None:
    """``min x² + y² - 4 x y`` is unbounded without the pair; with it the origin is the minimum."""
    z, (x, y) = symbols(2)
    solution = solve(MPCC(z, x**2 + y**2 - 4 * x * y, x, y), x0=[1.0, 1.0])
    assert solution.success
    assert abs(solution.f) < 1e-8


def test_outrata_stackelberg() -> None:
    """In a duopoly the follower's best response to x is ``max(0, (24 - x) / 4)``.

    The leader solves ``min x²/2 + x y / 2 - 95 x``. The slope is 3 x / 4 - 92 < 0 for x < 24 and
    x - 95 above, so that x = 95, y = 0.
    """
    z, (x, y, s) = symbols(3)
    f = x**2 / 2 + x * y / 2 - 95 * x
    solution = solve(MPCC(z, f, s, y, g=2 * y + x / 2 - 12 - s, lbx=[0.0, -1.0, -1.0]), x0=10.0)
    assert solution.success
    assert solution.x[:2] == pytest.approx([95, 0], abs=1e-4)


@pytest.mark.costly
def test_expressions_as_sides_against_all_branches() -> None:
    """The solution costs as little as the best of the branches at it, each solved in closed form."""
    rng = np.random.default_rng(3)
    for _ in range(4):
        A, B = rng.normal(size=(2, 4)), rng.normal(size=(2, 4))
        a, b, c = rng.uniform(0.5, 1, 2), rng.uniform(0.5, 1, 2), rng.normal(size=4)
        x = ca.SX.sym("x", 4)
        mpcc = MPCC(x, ca.sumsqr(x - c), ca.mtimes(A, x) + a, ca.mtimes(B, x) + b)
        solution = solve(mpcc)
        assert solution.success
        assert np.minimum(solution.G, solution.H) == pytest.approx([0, 0], abs=1e-7)
        holding = [
            branch_minimum(A, a, B, b, c, chosen)
            for chosen in product((False, True), repeat=2)
            if np.all(np.where(chosen, solution.H, solution.G) < 1e-6)
        ]
        assert holding
        assert solution.f == pytest.approx(min(holding), rel=1e-6)


def branch_minimum(
    A: np.ndarray,
    a: np.ndarray,
    B: np.ndarray,
    b: np.ndarray,
    c: np.ndarray,
    chosen: tuple[bool, ...],
) -> float:
    """Return ``min |x - c|²`` on a branch, by projections onto the affine subspaces of its active sets."""
    take = np.array(chosen)
    held, held_0 = np.where(take[:, None], B, A), np.where(take, b, a)
    free, free_0 = np.where(take[:, None], A, B), np.where(take, a, b)
    costs = []
    for active in product((False, True), repeat=2):
        on = np.array(active)
        rows, right = np.vstack([held, free[on]]), -np.concatenate([held_0, free_0[on]])
        x = c + np.linalg.pinv(rows) @ (right - rows @ c)
        if np.all(free @ x + free_0 >= -1e-9):
            costs.append(float((x - c) @ (x - c)))
    return min(costs)


def test_a_variable_may_be_a_side_of_several_pairs() -> None:
    """With x complementary to both y and z, the solution is (0, 1, 1) with cost 1."""
    v, (x, y, z) = symbols(3)
    f = (x - 1) ** 2 + (y - 1) ** 2 + (z - 1) ** 2
    solution = solve(MPCC(v, f, ca.vertcat(x, x), ca.vertcat(y, z)), x0=[0.0, 1.0, 1.0])
    assert solution.success
    assert solution.x == pytest.approx([0, 1, 1], abs=1e-6)


def test_a_side_that_is_bounded_above_zero_holds_the_other_at_zero() -> None:
    v, (x, y) = symbols(2)
    f = (x - 0.2) ** 2 + (y - 1) ** 2
    for order in ((x, y), (y, x)):
        solution = solve(MPCC(v, f, *order, lbx=[0.5, -np.inf]), x0=[0.0, 2.0])
        assert solution.success
        assert solution.x == pytest.approx([0.5, 0], abs=1e-6)


def test_symbols_of_one_name_are_told_apart() -> None:
    """The problem ``min x + (y - 1)²``, ``0 <= y ⟂ z >= 0`` is solved if all three symbols are called "a"."""
    x, y, z = (ca.SX.sym("a") for _ in range(3))
    mpcc = MPCC(ca.vertcat(x, y, z), x + (y - 1) ** 2, y, z, lbx=[0.0, -np.inf, -np.inf])
    solution = solve(mpcc, x0=[1.0, 0.5, 0.0])
    assert solution.success
    assert solution.x == pytest.approx([0, 1, 0], abs=1e-6)


def test_without_pairs_it_is_an_nlp() -> None:
    x = ca.SX.sym("x")
    solution = solve(MPCC(x, (x - 3) ** 2, ca.SX(0, 1), ca.SX(0, 1), ubx=2.0))
    assert solution.success
    assert solution.x == pytest.approx([2], abs=1e-6)


@pytest.mark.parametrize(
    ("mpcc", "named"),
    [
        (lambda v, x, y: MPCC(v, x + y, x, y, lbx=1.0, names=["wall"]), "wall"),
        (lambda v, x, y: MPCC(v, x, -1 - x * x, y, names=["wall"]), "constraint G >= 0 of 'wall'"),
        (lambda v, x, y: MPCC(v, x, x, y, g=x * x + y * y, lbg=-1.0, ubg=-1.0), "constraint g[0]"),
    ],
)
def test_an_infeasible_problem_is_said_to_be_with_what_cannot_be_met(mpcc: Any, named: str) -> None:
    v, (x, y) = symbols(2)
    solution = solve(mpcc(v, x, y), x0=[0.5, 0.5])
    assert not solution.success
    assert solution.status is Status.INFEASIBLE
    assert solution.infeasibility > 0.4
    assert "ocally infeasible" in solution.verdict
    assert named in solution.verdict


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"f": ca.SX(2, 1)}, "f has 2 entries"),
        ({"G": ca.SX.sym("G", 2)}, "G has 2 entries and H 1"),
        ({"lbx": [0.0, 0.0, 0.0]}, "lbx has 3 entries, expected 2"),
        ({"ubg": [0.0, 1.0]}, "ubg has 2 entries, expected 1"),
        ({"lbx": [0.0, 2.0], "ubx": 1.0}, r"bounds of x\[1\] cross: 2 > 1"),
        ({"lbg": 1.0}, r"bounds of g\[0\] cross: 1 > 0"),
        ({"lbx": [0.0, np.nan]}, r"bounds of x\[1\] cross"),
        ({"names": ["a", "b"]}, "2 names for 1 pairs"),
        ({"f": ca.SX.sym("stranger")}, "stranger is neither in x nor in p"),
    ],
)
def test_bad_statements(given: dict[str, Any], said: str) -> None:
    v, (x, y) = symbols(2)
    good = {"x": v, "f": x, "G": x, "H": y, "g": x - y}
    with pytest.raises(InputError, match=said):
        MPCC(**{**good, **given})


def test_a_pair_that_is_the_same_variable_twice() -> None:
    v, (x, y) = symbols(2)
    with pytest.raises(InputError, match="'only' is the same expression twice"):
        MPCC(v, x + y, x, x, names=["only"])


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"x0": [0.0, np.nan]}, r"x0\[1\] is nan"),
        ({"x0": [0.0] * 3}, "x0 has 3 entries, expected 2"),
        ({"strategies": ["magic"]}, "unknown strategy 'magic'"),
        ({"solver": "magic"}, "unknown solver 'magic'"),
    ],
)
def test_bad_calls(given: dict[str, Any], said: str) -> None:
    v, (x, y) = symbols(2)
    with pytest.raises(InputError, match=said):
        solve(MPCC(v, x + y, x, y), **given)


def test_a_missing_parameter_is_said() -> None:
    with pytest.raises(InputError, match="p has 0 entries, expected 1"):
        solve(bilevel(ca.SX.sym("p")))


def test_derivatives_of_every_form_are_those_of_its_functions() -> None:
    """Derivatives equal those by CasADi of f_g, at a random point with random multipliers."""
    v, (x, y, z) = symbols(3)
    sides = ca.vertcat(x * y, ca.exp(z)), ca.vertcat(y, x + z**2)
    mpcc = MPCC(v, ca.sin(x) * z + y**4, *sides, g=x * y * z)
    programs = programs_of(mpcc, np.zeros(0), np.zeros(v.numel()))
    rng = np.random.default_rng(0)
    for reformulation in ("none", "product", "fischer-burmeister", "lin-fukushima"):
        nlp = programs(reformulation)
        at, p, lam = rng.uniform(1, 2, nlp.n), np.array([0.7, 0.3]), rng.normal(size=nlp.m)
        u = ca.MX.sym("u", nlp.n)
        f, g = nlp.f_g(u, p)
        lagrangian = 1.3 * f + ca.dot(lam, g)
        own = ca.Function("own", [u], [ca.gradient(f, u), ca.jacobian(g, u), ca.hessian(lagrangian, u)[0]])
        slope, jacobian, hessian = (np.array(value) for value in own(at))
        assert np.array(nlp.gradient(at, p)[1]) == pytest.approx(slope, abs=1e-12)
        assert np.array(nlp.jacobian(at, p)[1]) == pytest.approx(jacobian, abs=1e-12)
        given = np.array(nlp.hessian(at, p, 1.3, lam))
        assert given == pytest.approx(np.triu(hessian), abs=1e-12)


def unsolved(nlp: Any, x: list[float]) -> Result:
    return Result(Point(np.array(x)), 0.0, np.zeros(nlp.m), Status.SOLVED, "relaxed", 0, 0.0)


def test_a_branch_that_cannot_be_guessed_is_proposed() -> None:
    """At (0.002, 0.001) x is the larger side, but ``y = 0.001`` requires x = 0."""
    v, (x, y) = symbols(2)
    follower = follower_of(MPCC(v, (x - 1) ** 2, x, y, g=y - 1e-3, ubx=[np.inf, 2.0]))
    nlp = follower.nlp_of("none")
    start = unsolved(nlp, [2e-3, 1e-3])
    assert Branches(follower).solve_branch(start.point) is None
    found = polish(follower, nlp, start)
    assert found.finished
    assert found.result.point.x == pytest.approx([0, 1e-3], abs=1e-8)


def test_an_infeasible_branch_is_left_for_the_other() -> None:
    """From (0.2, 0) the branch y = 0 cannot satisfy ``y - x = 1``; the other branch can."""
    v, (x, y) = symbols(2)
    found = solve(MPCC(v, x, x, y, g=y - x - 1), [0.2, 0.0])
    assert found.success and found.x == pytest.approx([0, 1], abs=1e-8)


def test_the_softened_problem_without_cost_leaves_the_least_violation() -> None:
    """``x = 1`` and ``y = 2`` contradict the pair: violating the first costs 1, the second 2."""
    v, (x, y) = symbols(2)
    mpcc = MPCC(v, x, x, y, g=ca.vertcat(x - 1, y - 2))
    found = solve(solving.softened(mpcc, 0.0, 1.0))
    assert found.success and found.f == pytest.approx(1, abs=1e-8)
    assert found.x == pytest.approx([0, 2, 0, 0, 1, 0], abs=1e-8)
    assert solve(mpcc, [0.1, 0.3]).status is Status.INFEASIBLE


@pytest.mark.parametrize("weight", [2.1, 10.0])
def test_the_softened_problem_is_the_problem_above_a_weight(weight: float) -> None:
    """For min (x - 3)² with x = 2 the row's multiplier is 2, so that a larger weight gives the exact solution."""
    v, (x, y) = symbols(2)
    mpcc = MPCC(v, (x - 3) ** 2, x, y, g=x - 2)
    assert solve(solving.softened(mpcc, 1.0, weight)).x[0] == pytest.approx(2, abs=1e-6)
    below = solve(solving.softened(mpcc, 1.0, 1.0)).x[0]
    assert below == pytest.approx(2.5, abs=1e-6), "a weight of 1 buys 1/2 of violation"


def test_rows_may_be_more_than_variables() -> None:
    """Redundant rows are allowed: three multiples of one line, and products that the pair already implies."""
    v, (x, y) = symbols(2)
    line = x + y - 1
    found = solve(MPCC(v, (x - 1) ** 2 + (y - 2) ** 2, x, y, g=line * ca.DM([1, 2, 3])), [0.3, 0.3])
    assert found.success and found.x == pytest.approx([0, 1], abs=1e-8)
    v, (x, y, z) = symbols(3)
    rows = ca.vertcat((x + z - 1) * ca.DM([1, 2, 3]), x * y, x**2 - x * (1 - z))
    found = solve(MPCC(v, ca.sumsqr(v - 1), x, y, g=rows), [0.3, 0.3, 0.0])
    assert found.success and found.x == pytest.approx([0, 1, 1], abs=1e-6)


@pytest.mark.one_case_in(3)
@pytest.mark.parametrize("name", ["tank-1 radau 10x3x2 fine", "hopper radau 10x3x2 fine"])
def test_switches_and_jumps_by_finite_elements(name: str) -> None:
    """The solution is certified and costs no more than that of a plain Scholtes loop."""
    problem, start = instances()[name]()
    found, loop = solve(problem, start), scholtes_peer.solve(problem, start)
    assert found.success and found.infeasibility <= 1e-6
    assert loop.converged and found.f <= loop.f * (1 + 1e-6) + 1e-7


@pytest.mark.one_case_in(3)
@pytest.mark.parametrize("factor", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("rows", [{}, {"lbg": -np.inf, "ubg": 10.0}], ids=["none", "one"])
def test_programs_of_one_row_are_solved_at_every_size_of_the_cost(factor: float, rows: dict[str, float]) -> None:
    """By enumeration x = 0, y = 3 costs 4 factor, and x = 2, y = 0 costs 9 factor."""
    x, (a, b) = symbols(2)
    more = {"g": a + b, **rows} if rows else {}
    cost = factor * ((a - 2) ** 2 + (b - 3) ** 2)
    found = solve(MPCC(x=x, f=cost, G=a, H=b, **more), x0=[0.0, 0.0])
    assert found.success
    np.testing.assert_allclose(found.x, [0, 3], atol=1e-5)
    assert found.f == pytest.approx(4 * factor, rel=1e-6)
