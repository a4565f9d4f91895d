"""Scripts of casadi.Opti: values, duals, parameters in loops, callbacks, scales, and what is refused."""

from __future__ import annotations

from itertools import product

import casadi as ca
import numpy as np
import pytest

import ocp
from ocp import complements
from ocp.errors import InputError, NotConverged


def game(cost_scale: float = 1.0) -> tuple[ca.Opti, list[ca.MX]]:
    """The follower's y is min(x, p); the leader pays ``(x - 2)² + (y - 3)²`` and x is at most q."""
    opti = ca.Opti()
    x, y, s = opti.variable(), opti.variable(), opti.variable()
    p, q = opti.parameter(), opti.parameter()
    opti.minimize((x - 2) ** 2 + (y - 3) ** 2, cost_scale)
    balance, most = y - x + s == 0, x <= q
    opti.subject_to([balance, most])
    opti.subject_to(s >= 0)
    opti.subject_to(p - y >= 0)
    opti.subject_to(complements(s, p - y))
    opti.set_value(p, 1)
    opti.set_value(q, 1.5)
    return opti, [x, y, s, p, q, balance, most]


def test_values_duals_and_sensitivities_are_those_of_the_closed_form() -> None:
    """With p = 1 and q = 1.5 the answer is x = q, y = p: cost ``(q - 2)² + (p - 3)²``."""
    opti, (x, y, s, p, q, balance, most) = game()
    solution = ocp.opti(opti).solve()
    assert "B-stationary" in solution.verdict and solution.stats()["success"]
    assert solution.value(ca.vertcat(x, y, s)) == pytest.approx([1.5, 1.0, 0.5], abs=1e-6)
    assert solution.value(opti.f) == pytest.approx(0.25 + 4.0, abs=1e-6)
    assert solution.value(x, [x == 7]) == 7
    assert solution.value(opti.dual(most)) == pytest.approx(1.0, abs=1e-5), "-df/dq"
    assert solution.value(opti.dual(balance)) == pytest.approx(0.0, abs=1e-5)
    assert solution.sensitivity(opti.f, ca.vertcat(p, q))[0] == pytest.approx([-4, -1], abs=1e-5)
    assert solution.sensitivity(ca.vertcat(x * p, y), p).ravel() == pytest.approx([1.5, 1.0], abs=1e-5)


def test_scales_of_the_opti_change_nothing() -> None:
    opti, (x, *_, most) = game(cost_scale=100.0)
    opti.set_linear_scale(x, 20.0, 3.0)
    solution = ocp.opti(opti).solve()
    assert solution.value(x) == pytest.approx(1.5, abs=1e-6)
    assert solution.value(opti.dual(most)) == pytest.approx(1.0, abs=1e-5)


def test_a_loop_over_a_parameter_builds_once_and_starts_warm(monkeypatch: pytest.MonkeyPatch) -> None:
    stack, (x, y, _, p, *_) = game()
    opti = ocp.opti(stack, warm_start=True)
    built, presolve = [], ocp.mpcc.opti.presolve
    monkeypatch.setattr("ocp.mpcc.opti.presolve", lambda *arguments: built.append(1) or presolve(*arguments))
    solutions = []
    for value in (0.0, 0.5, 1.2):
        opti.set_value(p, value)
        solutions.append(opti.solve())
        opti.set_initial(solutions[-1].value_variables())
    assert len(built) == 1
    assert [solution.value(y) for solution in solutions] == pytest.approx([0.0, 0.5, 1.2], abs=1e-6)
    assert solutions[-1].report.strategy == "warm start"
    with pytest.raises(InputError, match="last solve"):
        solutions[0].sensitivity(x, p)
    opti.subject_to(x <= 1.1)
    assert opti.solve().value(x) == pytest.approx(1.1, abs=1e-6) and len(built) == 2


def test_constraints_that_are_replaced_are_solved_as_they_are() -> None:
    """The largest x with ``0 <= x ⟂ y >= 0`` is its bound, which is cleared and stated again with another number."""
    stack = ca.Opti()
    x, y = stack.variable(), stack.variable()
    stack.minimize((y - 1) ** 2 - x)
    opti = ocp.opti(stack)
    for bound in (3.0, 2.0, 5.0):
        opti.subject_to()
        opti.subject_to(x <= bound)
        opti.subject_to(complements(x, y))
        assert opti.solve().value(x) == pytest.approx(bound, abs=1e-6)


def test_a_callback_reads_the_last_values() -> None:
    stack, (x, *_) = game()
    seen: list[float] = []
    stack.callback(lambda i: seen.append(opti.debug.value(x)))
    opti = ocp.opti(stack)
    solution = opti.solve()
    assert min(abs(np.array(seen) - solution.value(x))) < 1e-6 and opti.value(x) == solution.value(x)


def test_matrices_are_complementary_entry_by_entry() -> None:
    """Each entry of ``|X - T|²`` with ``0 <= X ⟂ Y >= 0`` and ``X + Y = C`` is 0 or C, whichever is nearer T."""
    target, total = np.array([[0.2, 0.9, -1.0], [3.0, 1.4, 0.4]]), np.full((2, 3), 1.0)
    total[1, 1] = 3.0
    opti = ca.Opti()
    X, Y = opti.variable(2, 3), opti.variable(2, 3)
    C = opti.parameter(2, 3)
    opti.set_value(C, total)
    opti.minimize(ca.sumsqr(X - target))
    opti.subject_to(ca.vec(X + Y - C) == 0)
    opti.subject_to(complements(X, Y))
    opti.set_initial(X, target)
    solution = ocp.opti(opti).solve()
    best = np.where(np.abs(target) <= np.abs(target - total), 0.0, total)
    every = [np.reshape(choice, (2, 3)) * total for choice in product((0.0, 1.0), repeat=6)]
    np.testing.assert_allclose(min(every, key=lambda x: np.sum((x - target) ** 2)), best)
    np.testing.assert_allclose(solution.value(X), best, atol=1e-6)


def test_what_cannot_be_met_is_named_by_its_line() -> None:
    opti = ca.Opti()
    x, y = opti.variable(), opti.variable()
    opti.subject_to(x + y <= -1)
    opti.subject_to(complements(x, y))
    with pytest.raises(NotConverged, match=r"line \d+ of test_opti\.py"):
        ocp.opti(opti).solve()


def test_integers_and_parameters_without_values_are_refused() -> None:
    opti, _ = game()
    integer = opti.variable()
    opti.set_domain(integer, "integer")
    opti.subject_to(integer >= 0)
    with pytest.raises(InputError, match="integer variable"):
        ocp.opti(opti).solve()
    opti = ca.Opti()
    x, p = opti.variable(), opti.parameter()
    opti.subject_to(complements(x, x - p))
    with pytest.raises(InputError, match="set_value"):
        ocp.opti(opti).solve()


def test_anything_but_an_opti_with_variables_is_refused() -> None:
    with pytest.raises(InputError, match=r"got a int; expected a casadi\.Opti"):
        ocp.opti(3)  # pyright: ignore[reportArgumentType]
    with pytest.raises(InputError, match="has no variables"):
        ocp.opti(ca.Opti()).solve()


def test_a_derivative_by_anything_but_a_parameter_is_refused() -> None:
    opti = ca.Opti()
    x, y, p = opti.variable(), opti.variable(), opti.parameter()
    opti.subject_to(complements(x, y))
    opti.minimize((x - p) ** 2 + y)
    opti.set_value(p, 1)
    solution = ocp.opti(opti).solve()
    np.testing.assert_allclose(solution.sensitivity(x, p), [[1.0]], atol=1e-8)
    for other in (y, 2.0):
        with pytest.raises(InputError, match="no parameter of this Opti"):
            solution.sensitivity(x, other)


def test_a_problem_without_slopes_is_solved_without_warnings(recwarn: pytest.WarningsRecorder) -> None:
    opti = ca.Opti()
    x, y = opti.variable(), opti.variable()
    opti.subject_to(complements(x, y))
    opti.subject_to(x + y == 1)
    solution = ocp.opti(opti).solve()
    assert sorted([solution.value(x), solution.value(y)]) == pytest.approx([0, 1], abs=1e-8)
    assert not recwarn.list
