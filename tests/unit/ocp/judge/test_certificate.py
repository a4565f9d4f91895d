"""Certificates agree with enumerated branches and textbook examples, and survive failures of the search."""

from __future__ import annotations

import itertools
import os
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, get_args

import casadi as ca
import numpy as np
import pytest
import scipy.linalg as la
import scipy.optimize
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from dynamics.systems.pairs import Kind
from ocp.judge import lpec
from ocp.judge.certificate import PAIR_CHANGES, _steep_factors, certify
from ocp.judge.lpec import LinearModel, negative_curvature
from tests.unit.ocp.mpcc.mpcc_cases import SmallMPCC, free_pair, scheel_scholtes

RADIUS = 1e-3


def judge(case: SmallMPCC, x: list[float], **more):
    return certify(case, np.array(x), np.zeros(1), case.bounds(), **more)


def random_model(seed: int, biactive: bool) -> LinearModel:
    """Draw a linear model of five variables, three pairs near zero, three equations and two inequalities."""
    rng = np.random.default_rng(seed)
    n, pairs = 11, np.array([[5, 6, 7], [8, 9, 10]])
    x = rng.standard_normal(n)
    x[pairs] = 0.0 if biactive else rng.uniform(0, RADIUS, (2, 3)) * rng.integers(0, 2, (1, 3))
    x[pairs[1]] *= x[pairs[0]] == 0
    J = sp.csr_matrix(rng.standard_normal((5, n)) * (rng.random((5, n)) < 0.7))
    ends = np.array([0, 0, 0, -np.inf, -np.inf]), np.zeros(5)
    lower = np.full(n, -np.inf)
    lower[pairs.ravel()] = 0.0
    bounds = {"lbx": lower, "ubx": np.full(n, np.inf), "lbg": ends[0], "ubg": ends[1]}
    slopes = rng.standard_normal(n), np.zeros(5), J
    program: Any = SimpleNamespace(
        reformulation="none",
        pairs=pairs,
        sizes=np.ones_like,
        first_derivatives=lambda x, p: slopes,
        typical_change=lambda *_: 0.0,
    )
    return LinearModel.at(program, x, np.zeros(0), bounds)


def enumerated(model: LinearModel) -> float:
    """Return the largest decrease over all branches, each solved as a linear program."""
    near = np.flatnonzero(model.near(RADIUS))
    lower, upper = model.box(RADIUS)
    equal = model.row_lower == model.row_upper
    best = 0.0
    for sides in itertools.product((0, 1), repeat=near.size):
        low, high = lower.copy(), upper.copy()
        held = model.pairs[list(sides), near]
        high[held] = low[held] = -model.members[list(sides), near] / RADIUS
        found = linprog(
            model.cost,
            model.rows[~equal],
            model.row_upper[~equal] / RADIUS,
            model.rows[equal],
            np.zeros(equal.sum()),
            np.stack([low, high], axis=1),
        )
        best = max(best, -found.fun) if found.status == 0 else best
    return best


@pytest.mark.costly
@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**31 - 1), st.booleans())
def test_the_lpec_finds_a_descent_exactly_where_a_branch_has_one(seed: int, biactive: bool) -> None:
    model = random_model(seed, biactive)
    known, cut = enumerated(model), 1e-6
    found = model.descend(RADIUS, True, cut)
    assert (found.decrease > cut) == (known > cut)
    assert found.decrease <= known + 1e-7
    assert found.decrease >= 0.5 * known - 1e-6, "the gap at which the search may stop"
    after = model.members + RADIUS * found.step[model.pairs]
    # A pair's member below a millionth of its size counts as zero.
    assert np.abs(np.minimum(after[0], after[1])).max() <= 1e-6, "the direction keeps the pairs"
    assert np.abs((model.rows @ found.step)[:3]).max() <= 1e-6


@pytest.mark.costly
@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**31 - 1), st.booleans())
def test_weak_duality_bounds_the_relaxed_descent(seed: int, biactive: bool) -> None:
    model = random_model(seed, biactive)
    relaxed = model.descend(RADIUS, False, 0.0)
    rng = np.random.default_rng(seed)
    y = rng.standard_normal(5)
    y[3:] = np.abs(y[3:])
    assert model.dual_bound(y, RADIUS) >= relaxed.decrease - 1e-7
    assert relaxed.decrease >= enumerated(model) - 1e-7, "relaxing pairs only adds directions"


def test_a_relaxed_descent_on_a_branch_is_the_steepest_of_all_branches() -> None:
    on_a_branch = 0
    for seed in range(20):
        model = random_model(seed, biactive=seed % 2 == 0)
        relaxed = model.descend(RADIUS, False, 0.0)
        descent = model.on_branch(relaxed, RADIUS)
        if descent is None:
            continue
        on_a_branch += 1
        assert descent.decrease == pytest.approx(enumerated(model), rel=1e-6, abs=1e-9)
        ends = model.members[:, descent.near] / RADIUS + descent.step[model.pairs[:, descent.near]]
        np.testing.assert_allclose(np.where(descent.active > 0.5, ends[1], ends[0]), 0.0, atol=1e-6)
    assert 2 < on_a_branch < 18


@pytest.mark.parametrize("seed", range(6))
def test_large_programs_have_the_same_optimum_by_the_interior_point_method(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = random_model(seed, biactive=True)
    by_simplex = model.descend(RADIUS, False, 0.0)
    called = []
    by_interior_point = lpec._by_interior_point
    monkeypatch.setattr(lpec, "_LARGE", 0)
    monkeypatch.setattr(lpec, "_by_interior_point", lambda *a: called.append(1) or by_interior_point(*a))
    descent = model.descend(RADIUS, False, 0.0)
    assert called and descent.decrease == pytest.approx(by_simplex.decrease, rel=1e-6, abs=1e-9)
    rows = model.rows @ descent.step
    assert np.all(rows >= model.row_lower / RADIUS - 1e-6) and np.all(rows <= model.row_upper / RADIUS + 1e-6)


def test_the_bound_is_attained_at_the_programs_own_multipliers() -> None:
    model = random_model(3, True)
    lower, upper = model.box(RADIUS)
    rows = model.rows
    found = linprog(
        model.cost,
        rows[3:],
        model.row_upper[3:] / RADIUS,
        rows[:3],
        np.zeros(3),
        np.stack([lower, upper], axis=1),
    )
    y = -np.concatenate([found.eqlin.marginals, found.ineqlin.marginals]) * model.row_scale
    assert model.dual_bound(y, RADIUS) == pytest.approx(-found.fun, abs=1e-9)


@settings(max_examples=80, deadline=None)
@given(st.integers(0, 2**31 - 1), st.integers(2, 12), st.integers(0, 6))
def test_inertia_counts_the_reduced_hessians_negative_eigenvalues(seed: int, n: int, m: int) -> None:
    rng = np.random.default_rng(seed)
    m = min(m, n - 1)
    H = rng.standard_normal((n, n))
    H, A = H + H.T, rng.standard_normal((m, n))
    Z = la.null_space(A) if m else np.eye(n)
    values = np.linalg.eigvalsh(Z.T @ H @ Z)
    if np.abs(values).min() < 1e-3:
        return
    found = negative_curvature(sp.csr_matrix(H), sp.csr_matrix(A))
    assert found in (int((values < 0).sum()), -1)


def test_rows_of_the_linear_model_allow_the_steps_that_the_constraints_allow() -> None:
    """For affine constraints and bounds a step is feasible exactly where the model, with residuals, says so."""
    rng, x = np.random.default_rng(0), np.array([0.3, -0.2, 0.5])
    A = np.diag([4.0, 0.1, 30.0]) @ rng.normal(size=(3, 3))
    slack = np.array([[-0.3, 0.4], [-0.02, np.inf], [0.0, 0.0]])
    lower, upper = (A @ x + slack.T)[:, :3]
    lower[2], upper[2] = lower[2] + 0.7, upper[2] + 0.7
    symbols = ca.SX.sym("x", 3)
    case = SmallMPCC(symbols, symbols[0], ca.mtimes(A, symbols), list(lower), list(upper), [[], []])
    sizes = np.array([0.5, 2.0, 4.0])
    case.sizes = lambda x: sizes  # pyright: ignore
    bounds = {**case.bounds(), "lbx": x - 0.4, "ubx": x + 0.6}
    with_residuals, without = (LinearModel.at(case, x, np.zeros(1), bounds, residuals) for residuals in (True, False))
    np.testing.assert_allclose(abs(with_residuals.rows).max(axis=1).toarray().ravel(), 1.0)
    feasible = 0
    np.testing.assert_array_equal(with_residuals.cost, [0.5, 0.0, 0.0])
    for change in rng.uniform(-0.7, 0.7, (200, 3)):
        step = change + np.linalg.solve(A, [0.0, 0.0, lower[2] - A[2] @ (x + change)])
        allowed = np.all(A @ (x + step) >= lower - 1e-9) and np.all(A @ (x + step) <= upper + 1e-9)
        inside, d = np.all((step >= -0.4) & (step <= 0.6)), step / sizes
        values = with_residuals.rows @ d
        model_allows = np.all(values >= with_residuals.row_lower - 1e-9) and np.all(
            values <= with_residuals.row_upper + 1e-9
        )
        assert model_allows == allowed
        assert np.all((d >= with_residuals.lower) & (d <= with_residuals.upper)) == inside
        feasible += allowed
    assert 0 < feasible < 200
    np.testing.assert_allclose(without.row_lower[:2], with_residuals.row_lower[:2])
    np.testing.assert_allclose(without.row_upper[:2], with_residuals.row_upper[:2])
    assert without.row_lower[2] == without.row_upper[2] == 0.0, "the residual of an equation is left to the audit"


def test_a_steep_variable_gets_the_size_at_which_its_change_is_typical() -> None:
    """``f (|slope| + |curvature| / 2)`` is the typical change for factors f < 1; pairs and other variables keep 1."""
    model = replace(random_model(0, True), typical_change=0.02)
    slope, curvature = np.zeros(11), np.zeros(11)
    slope[:5] = 1.9, -2.1, 0.0, 0.0, -1.2
    curvature[:5] = 0.0, 0.0, 3.9, -4.1, 1.8
    slope[5] = 50.0
    factors = _steep_factors(replace(model, cost=slope), sp.csr_matrix(np.diag(curvature)))
    steep = np.isin(np.arange(11), [1, 3, 4])
    np.testing.assert_array_equal(factors[~steep], 1.0)
    np.testing.assert_allclose((factors * (np.abs(slope) + np.abs(curvature) / 2))[steep], 0.02)


def test_inertia_is_found_and_not_given_up() -> None:
    rng = np.random.default_rng(0)
    H, A = np.diag([1.0, -2.0, 3.0, -4.0]), rng.standard_normal((1, 4))
    Z = la.null_space(A)
    known = int((np.linalg.eigvalsh(Z.T @ H @ Z) < 0).sum())
    assert negative_curvature(sp.csr_matrix(H), sp.csr_matrix(A)) == known


def test_a_corner_that_both_branches_leave_is_c_stationary_and_not_b() -> None:
    corner = free_pair(lambda a, b: (a - 1) ** 2 + (b - 1) ** 2)
    found = judge(corner, [0.0, 0.0])
    assert found.stationarity == "not"
    assert found.biactive == 1
    assert found.lpec_decrease == pytest.approx(2.0, rel=1e-6)
    assert "contact 'c0'" in found.sentence
    assert judge(corner, [1.0, 0.0]).stationarity == "B"


def test_a_corner_with_both_multipliers_positive_is_strongly_stationary() -> None:
    found = judge(free_pair(lambda a, b: (a + 1) ** 2 + (b + 1) ** 2), [0.0, 0.0])
    assert (found.stationarity, found.kind, found.biactive) == ("B", "S", 1)
    assert found.negative_curvature == 0


def test_one_multiplier_of_the_wrong_sign_is_no_minimum() -> None:
    """The point is only weakly stationary: the cost falls as the second member grows."""
    assert judge(free_pair(lambda a, b: a - b + a**2 + b**2), [0.0, 0.0]).stationarity == "not"


def test_b_stationary_without_strong_stationarity_needs_the_branches() -> None:
    """In the example of Scheel and Scholtes the relaxed problem has a descent at the origin, but no branch has one."""
    case = scheel_scholtes()
    found = judge(case, [0.0, 0.0, 0.0])
    assert (found.stationarity, found.biactive) == ("B", 1)
    assert found.kind in ("M", "C", "W")
    assert found.kind != "S"


def test_a_smooth_point_is_judged_by_its_gradient() -> None:
    bowl = free_pair(lambda a, b: (a - 1) ** 2 + 2 * (b + 3) ** 2)
    smooth = replace(bowl, pairs=np.zeros((2, 0)), reformulation="product")
    at = judge(smooth, [1.0, -3.0])
    assert (at.stationarity, at.kind, at.lpec_decrease) == ("KKT", "", 0.0)
    off = judge(smooth, [1.0, -2.0])
    assert off.stationarity == "not"
    assert off.lpec_decrease == pytest.approx(4.0)
    assert off.kkt_residual == pytest.approx(4.0)


def test_negative_curvature_is_told_at_a_saddle() -> None:
    saddle = free_pair(lambda a, b: a**2 - b**2)
    smooth = replace(saddle, pairs=np.zeros((2, 0)), reformulation="product")
    found = judge(smooth, [0.0, 0.0])
    assert (found.stationarity, found.negative_curvature) == ("KKT", 1)


def test_a_search_that_ends_at_its_last_node_is_undecided(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    def limited(*_, options: dict[str, float], **__) -> SimpleNamespace:
        asked.append(options)
        return SimpleNamespace(status=4, x=None, message="HiGHS Status 16: Solution limit reached")

    monkeypatch.setattr(scipy.optimize, "milp", limited)
    found = judge(free_pair(lambda a, b: a + b), [0.0, 0.0])
    assert found.stationarity == "undecided" and not found.certified
    assert "Solution limit" in found.sentence
    assert all(set(options) == {"node_limit", "mip_rel_gap"} for options in asked), "none again"


def test_a_failing_program_is_undecided_with_its_word(monkeypatch: pytest.MonkeyPatch) -> None:
    said = SimpleNamespace(status=4, x=None, message="Solve error")
    monkeypatch.setattr(scipy.optimize, "milp", lambda *_, **__: said)
    found = judge(free_pair(lambda a, b: a + b), [0.0, 0.0])
    assert found.stationarity == "undecided"
    assert "Solve error" in found.sentence


def test_what_a_program_prints_past_its_switches_reaches_no_terminal(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """HiGHS calls printf if a solution of its search violates its own rows."""
    real, case = scipy.optimize.milp, free_pair(lambda a, b: a + b)
    known = judge(case, [0.0, 0.0])

    def loud(*given, **named):
        os.write(1, b"transformNewIntegerFeasibleSolution")
        return real(*given, **named)

    monkeypatch.setattr(scipy.optimize, "milp", loud)
    print("before")
    assert judge(case, [0.0, 0.0]).stationarity == known.stationarity
    print("after")
    assert capfd.readouterr() == ("before\nafter\n", "")


def test_no_number_is_undecided() -> None:
    found = judge(free_pair(lambda a, b: a + b), [np.nan, 0.0])
    assert found.stationarity == "undecided"
    assert "NaN or infinite" in found.sentence


def test_every_kind_of_pair_has_words_for_its_changes() -> None:
    assert {*get_args(Kind), "pair"} == set(PAIR_CHANGES)
