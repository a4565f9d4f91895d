"""Complementarity problems of the kind that users ask about, with sizes far from one.

Every expected value is from an enumeration of branches, by hand or in the test.
"""

from __future__ import annotations

import itertools

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from ocp.mpcc import MPCC, MPCCSolution, solve

a, b, c, d = (ca.SX.sym(name) for name in "abcd")
FREE = np.inf


@pytest.mark.cheap_cases("1000000000.0-start1", "1000000000.0-start2")
@pytest.mark.parametrize("start", [[0, 0, 0], [-1, 0.5, 1.5], [1, 1, 0]])
@pytest.mark.parametrize("ohms", [1e3, 1e5, 1e6, 1e7, 1e9])
def test_a_diode_of_a_large_resistor(ohms: float, start: list[float]) -> None:
    """The problem is ``min (v + 1)²/2 + (R i - 1/2)²`` with ``R i - v = w``, ``0 <= i ⟂ w >= 0``.

    A conducting diode (w = 0) has R i = v >= 0, and v = 0 costs 3/4. A blocking one (i = 0) has
    w = -v >= 0, and v = -1 costs 1/4, for any R.
    """
    problem = MPCC(
        ca.vertcat(a, b, c),
        0.5 * (a + 1) ** 2 + (ohms * b - 0.5) ** 2,
        b,
        c,
        g=ca.vertcat(ohms * b - a - c, a),
        lbg=[0, -5],
        ubg=[0, 5],
        lbx=[-2, -FREE, -FREE],
        ubx=[2, FREE, FREE],
    )
    conducting = minimize_scalar(lambda v: 0.5 * (v + 1) ** 2 + (v - 0.5) ** 2, bounds=(0, 2), method="bounded")
    assert conducting.fun > 0.25
    found = solve(problem, np.array(start) / [1, ohms, 1])
    assert found.success
    assert found.f == pytest.approx(0.25, abs=1e-6)
    assert found.x[0] == pytest.approx(-1, abs=1e-3)


def priced(price: float) -> MPCCSolution:
    """Solve ``min (a - 2)² + (b - 3)² + (d - 1)^4 + price c`` with ``0 <= a ⟂ b >= 0`` and c at its bound."""
    problem = MPCC(
        ca.vertcat(a, b, c, d),
        (a - 2) ** 2 + (b - 3) ** 2 + (d - 1) ** 4 + price * c,
        a,
        b,
        g=ca.vertcat(a + b - d, d + c),
        lbg=-FREE,
        ubg=[10, 20],
        lbx=[-FREE, -FREE, 0, -5],
        ubx=[FREE, FREE, 10, 5],
    )
    return solve(problem, [0, 0, 1, 4])


@pytest.mark.one_case_in(5)
@pytest.mark.parametrize("price", [1.0, 1e4, 1e6, 1e8, 1e10])
def test_a_steep_price_at_its_bound_loosens_no_certificate(price: float) -> None:
    """Of the branches a = 0, b = 3 costs 4, and a = 2, b = 0 costs 9; c = 0 and d = 1 in both."""
    found = priced(price)
    assert found.success
    assert found.f == pytest.approx(4, abs=1e-5)
    assert found.certificate.tolerance <= 10 * priced(1.0).certificate.tolerance


@pytest.mark.cheap_cases("10000000000.0-start1")
@pytest.mark.parametrize("start", [[0, 0, 0], [0.5, 0.5, 9]])
@pytest.mark.parametrize("offset", [1e4, -1e6, 1e8, 1e10])
def test_a_constant_changes_neither_the_answer_nor_the_certificate(offset: float, start: list[float]) -> None:
    """(1, 0) and (0, 1) both cost 1 plus the constant."""

    def shifted(constant: float) -> MPCCSolution:
        cost = constant + (a - 1) ** 2 + (b - 1) ** 2 + 1e-2 * (c - 3) ** 2
        rows = ca.vertcat(a + b - c, c + a)
        return solve(MPCC(ca.vertcat(a, b, c), cost, a, b, g=rows, lbg=-FREE, ubg=[10, 20]), start)

    plain, found = shifted(0.0), shifted(offset)
    assert plain.success
    assert plain.f == pytest.approx(1, abs=1e-6)
    assert np.array_equal(found.x, plain.x)
    assert found.certificate.tolerance == plain.certificate.tolerance
    assert found.f - offset == pytest.approx(plain.f, abs=1e-6 + 1e-15 * abs(offset))


@pytest.mark.cheap_cases("1-1.0", "2-1.0", "2-10000.0")
@pytest.mark.parametrize("factor", [1e-6, 1e-3, 1.0, 1e4, 1e6])
@pytest.mark.parametrize("rows", [0, 1, 2])
def test_one_row_or_none_or_two_at_any_size_of_the_cost(factor: float, rows: int) -> None:
    """Of the branches a = 0, b = 3 costs 4 factor, and a = 2, b = 0 costs 9 factor."""
    g = ca.vertcat(*[a + b, a - b][:rows]) if rows else ca.SX(0, 1)
    cost = factor * ((a - 2) ** 2 + (b - 3) ** 2)
    found = solve(MPCC(ca.vertcat(a, b), cost, a, b, g=g, lbg=-FREE, ubg=10), [0, 0])
    assert found.success
    assert found.f / factor == pytest.approx(4, rel=1e-6)


@pytest.mark.parametrize("factor", [1e-4, 1.0, 1e5])
def test_a_side_that_is_an_expression_without_any_row(factor: float) -> None:
    """For ``a ⟂ b - 1`` both a = 0, b = 3 and a = 2, b = 1 cost 4 factor."""
    cost = factor * ((a - 2) ** 2 + (b - 3) ** 2)
    found = solve(MPCC(ca.vertcat(a, b), cost, a, b - 1), [0, 0])
    assert found.success
    assert found.f / factor == pytest.approx(4, rel=1e-6)


@pytest.mark.parametrize("unit", [1e-3, 1.0, 1e3, 1e6])
def test_one_equation_in_any_unit(unit: float) -> None:
    """The follower has ``b = 1`` if s > 0, else ``b = a``; the leader's best a is 2, which costs (1 - 3)²."""
    problem = MPCC(ca.vertcat(a, b, c), (a - 2) ** 2 + (b - 3) ** 2, c, 1 - b, g=unit * (b - a + c))
    found = solve(problem, [0, 0, 0])
    assert found.success
    assert found.f == pytest.approx(4, rel=1e-6)


@pytest.mark.parametrize("unit", [1.0, 1e3, 1e6])
def test_a_budget_in_cents(unit: float) -> None:
    cost = (a - 2) ** 2 + (b - 3) ** 2
    budget = {"g": unit * (a + b), "lbg": -FREE, "ubg": 10 * unit}
    found = solve(MPCC(ca.vertcat(a, b), cost, a, b, **budget), [0, 0])
    assert found.success
    assert found.f == pytest.approx(4, rel=1e-6)


@pytest.mark.parametrize("start", [[0, 0], [1.2, 3], [3, 0.1]])
def test_a_bound_of_one_as_a_side(start: list[float]) -> None:
    """For ``a - 1 ⟂ b`` both (1, 1) and (2, 0) cost 1."""
    cost = (a - 2) ** 2 + (b - 1) ** 2
    found = solve(MPCC(ca.vertcat(a, b), cost, a - 1, b), start)
    assert found.success
    assert found.f == pytest.approx(1, abs=1e-6)


def box_equilibria(F, low: float, high: float) -> list[float]:
    """Return all x in [low, high] that solve the box-constrained complementarity problem of F, by its branches."""
    inner = np.linspace(low, high, 100_001)
    values = F(inner)
    zeros = inner[np.flatnonzero(np.diff(np.sign(values)) != 0)]
    return [*zeros, *([low] if F(low) >= 0 else []), *([high] if F(high) <= 0 else [])]


@pytest.mark.parametrize("start", [[0, 0, 0], [2, 0, 0], [-1.5, 1, 1]])
@pytest.mark.parametrize(
    ("F", "low", "high", "cost"),
    [(lambda x: x - 3, -1, 2, lambda x: x**2), (lambda x: 1 - x**2, -2, 2, lambda x: x)],
    ids=["one", "three"],
)
def test_a_doubly_bounded_variable(F, low: float, high: float, cost, start: list[float]) -> None:
    """The solution of ``F(x) = s - w``, ``x - low ⟂ s``, ``high - x ⟂ w`` is the best of all equilibria."""
    problem = MPCC(
        ca.vertcat(a, b, c),
        cost(a),
        ca.vertcat(a - low, high - a),
        ca.vertcat(b, c),
        g=F(a) - b + c,
    )
    known = [cost(x) for x in box_equilibria(F, low, high)]
    found = solve(problem, start)
    assert found.success
    assert min(abs(found.f - one) for one in known) < 1e-3, "an equilibrium"
    assert found.f == pytest.approx(min(known), abs=1e-3) or len(known) > 1


@pytest.mark.parametrize("start", [[0, 0], [-1, 0], [1.4, 1], [0, 2], [2, 5]])
def test_a_parabola_and_a_circle(start: list[float]) -> None:
    """With ``0 <= y - x² + 1 ⟂ y >= 0`` and ``(x - 1)² + (y - 1)² <= 3`` the minimum is zero at (1, 0)."""
    problem = MPCC(
        ca.vertcat(a, b),
        (a - 1 - b) ** 2,
        b - a**2 + 1,
        b,
        g=ca.vertcat(a**2, (a - 1) ** 2 + (b - 1) ** 2),
        lbg=-FREE,
        ubg=[2, 3],
        lbx=[-1, -FREE],
        ubx=[2, FREE],
    )

    def allowed(x: float, y: float) -> bool:
        return -1 <= x <= 2 and x**2 <= 2 and (x - 1) ** 2 + (y - 1) ** 2 <= 3

    grid = np.linspace(-1, 2, 3001)
    branches = [
        *((x, 0.0) for x in grid if x**2 <= 1),
        *((x, x**2 - 1) for x in grid if x**2 >= 1),
    ]
    least = min((x - 1 - y) ** 2 for x, y in branches if allowed(x, y))
    found = solve(problem, start)
    assert found.success
    assert least < 1e-12
    assert found.f == pytest.approx(0, abs=1e-8)


@pytest.mark.one_case_in(3)
@pytest.mark.parametrize("pascal", [1.0, 1e5, 1e8])
def test_a_network_in_pascals_against_all_branches(pascal: float) -> None:
    """Two check valves in a row have flows [m³/s] and pressures in units of ``1/pascal``.

    The problem is ``min sum (q_i - 1)² + (p_1 - 2)² + (p_2 + 1)²`` with ``q_i ⟂ drop_i``.
    """
    drops = ca.vertcat(c / pascal - d / pascal, d / pascal)
    cost = (a - 1) ** 2 + (b - 1) ** 2 + (c / pascal - 2) ** 2 + (d / pascal + 1) ** 2
    found = solve(MPCC(ca.vertcat(a, b, c, d), cost, ca.vertcat(a, b), drops), np.zeros(4))
    costs = []
    for open_1, open_2 in itertools.product((True, False), repeat=2):
        # Open valves have no drop and the desired flow, closed ones no flow and desired pressures.
        flows = 2 - open_1 - open_2
        grid = np.linspace(0, 3, 601)
        pressures = min(
            (p1 - 2) ** 2 + (p2 + 1) ** 2
            for p2 in ([0.0] if open_2 else grid)
            for p1 in ([p2] if open_1 else grid[grid >= p2])
        )
        costs.append(flows + pressures)
    assert found.success
    assert found.f == pytest.approx(min(costs), abs=1e-6)
