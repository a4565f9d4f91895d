"""Derivatives of the step map agree with differences, for every law."""

from __future__ import annotations

from functools import cache

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import problems
from dynamics.contact import Adaptive, Barrier, ContactLaw, Exact, Randomized, Step
from dynamics.systems import ContactSystem, lcs
from problems import get
from tests.examples import settings
from tests.property.p_matrices import p_matrix


def own_mu(z: ca.SX, F: ca.SX) -> ca.SX:
    """Return mu of a user's law that couples the contacts."""
    return 0.02 / (1 + ca.sumsqr(z)) + 0.01 * z**2


LAWS: dict[str, ContactLaw] = {
    "barrier": Barrier(mu=0.03),
    "gaussian": Adaptive(sigma=0.3),
    "quartic": Adaptive(law="quartic", mu_max=0.05, scale=3.0),
    "quartic per contact": Adaptive(law="quartic-per-contact", mu_max=0.05, scale=3.0),
    "user": Adaptive(law=own_mu),
    "sobol over barrier": Randomized(sigma=0.2, samples=4, base=Barrier(mu=0.05)),
    "hermite over barrier": Randomized(
        sigma=0.2, samples=3, scheme="gauss-hermite", noise="input", base=Barrier(mu=0.05)
    ),
    "noisy state": Randomized(sigma=0.2, samples=4, noise="state", base=Barrier(mu=0.05)),
}


@cache
def system(contacts: int) -> ContactSystem:
    """Return a stable LCS with a nonsymmetric P-matrix and all sizes different."""
    rng = np.random.default_rng(contacts)
    nx, nu, n = 3, 2, contacts
    return lcs(
        "random",
        A=0.5 * rng.normal(size=(nx, nx)),
        B=rng.normal(size=(nx, nu)),
        C=rng.normal(size=(nx, n)),
        D=rng.normal(size=(n, nx)),
        E=rng.normal(size=(n, nu)),
        F=p_matrix("nonsymmetric" if n % 2 else "triangular", n, rng),
        c=rng.normal(size=nx),
        d=rng.normal(size=n),
    )


@cache
def closed(law: str, contacts: int) -> Step:
    return LAWS[law].close(system(contacts))


@cache
def derivatives(law: str, contacts: int) -> ca.Function:
    """Return ``w = (x, u, p) -> (y, dy/dw, d²(weights y)/dw²)``, y = (x_next, lam)."""
    step = closed(law, contacts)
    w = ca.MX.sym("w", 5 + len(step.p))
    y = ca.vertcat(*step.map(w[:3], w[3:5], w[5:]))
    weights = ca.DM(np.linspace(1, 2, y.numel()))
    return ca.Function("d", [w], [y, ca.jacobian(y, w), ca.hessian(ca.dot(weights, y), w)[0]])


def difference(function, w: np.ndarray, step: float = 1e-5) -> np.ndarray:
    """Return the Jacobian of a vector function by central differences."""
    columns = []
    for index in range(len(w)):
        shift = np.zeros(len(w))
        shift[index] = step * max(1.0, abs(w[index]))
        columns.append((function(w + shift) - function(w - shift)) / (2 * shift[index]))
    return np.stack(columns, axis=1)


points = st.integers(0, 2**32 - 1)


def point(law: str, contacts: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.concatenate([rng.normal(size=5), closed(law, contacts).p.values])


@pytest.mark.one_case_in(7)
@pytest.mark.parametrize("contacts", [1, 3, 4])
@pytest.mark.parametrize("law", LAWS)
@settings(max_examples=8)
@given(seed=points)
def test_jacobian(law, contacts, seed):
    evaluate = derivatives(law, contacts)
    w = point(law, contacts, seed)
    jacobian = np.array(evaluate(w)[1])
    expected = difference(lambda at: np.array(evaluate(at)[0]).ravel(), w)
    assert np.allclose(jacobian, expected, rtol=1e-5, atol=1e-6 * (1 + np.abs(expected).max()))


@pytest.mark.one_case_in(2)
@pytest.mark.parametrize("contacts", [1, 3])
@pytest.mark.parametrize("law", LAWS)
@settings(max_examples=4)
@given(seed=points)
def test_hessian(law, contacts, seed):
    evaluate = derivatives(law, contacts)
    w = point(law, contacts, seed)
    _, jacobian, hessian = evaluate(w)
    weights = np.linspace(1, 2, jacobian.shape[0])
    expected = difference(lambda at: np.array(evaluate(at)[1]).T @ weights, w)
    hessian = np.array(hessian)
    assert np.allclose(hessian, hessian.T, atol=1e-9 * np.abs(hessian).max())
    assert np.allclose(hessian, expected, rtol=1e-4, atol=1e-5 * (1 + np.abs(expected).max()))


@pytest.mark.parametrize("law", LAWS)
def test_the_explicit_map_satisfies_the_implicit_relation(law):
    step = closed(law, 3)
    s = step.system
    relation = ca.Function(
        "relation",
        [s.x, s.u, s.x_next, step.lam, step.p.vector],
        [step.residual, step.gap, step.mu],
    )
    for seed in range(5):
        w = point(law, 3, seed)
        x, u, p = w[:3], w[3:5], w[5:]
        x_next, lam, gap, error = (np.array(v).ravel() for v in step.solve(x, u, p))
        residual, implicit_gap, mu = (np.array(v).ravel() for v in relation(x, u, x_next, lam, p))
        assert np.max(np.abs(residual)) <= 1e-10
        assert np.allclose(implicit_gap, gap, atol=1e-9)
        assert np.allclose(lam * gap, mu, rtol=1e-8)
        assert np.max(error) <= 1e-10
        assert np.allclose(np.array(step.map(x, u, p)[0]).ravel(), x_next, atol=1e-14)


@settings(max_examples=25)
@given(seed=points)
def test_the_exact_law_has_the_derivative_of_its_active_set(seed):
    step = Exact().close(system(4))
    w = np.random.default_rng(seed).normal(size=5)
    x, u = ca.MX.sym("x", 3), ca.MX.sym("u", 2)
    y = ca.vertcat(*step.map(x, u, []))
    evaluate = ca.Function("d", [x, u], [y, ca.jacobian(y, ca.vertcat(x, u))])
    _, lam, gap, _ = (np.array(v).ravel() for v in step.solve(w[:3], w[3:], []))
    assert np.all(np.minimum(lam, gap) == 0)
    # The map is piecewise affine, so that differences are exact away from the edges of a piece.
    if np.min(lam + gap) > 1e-3:
        expected = difference(lambda at: np.array(evaluate(at[:3], at[3:])[0]).ravel(), w)
        assert np.allclose(np.array(evaluate(w[:3], w[3:])[1]), expected, atol=1e-7)


@pytest.mark.costly
@settings(max_examples=10)
@given(seed=points)
def test_a_frozen_gradient_is_that_of_the_barrier_at_the_same_mu(seed):
    w = np.random.default_rng(seed).normal(size=5)
    x, u = ca.MX.sym("x", 3), ca.MX.sym("u", 2)

    def evaluate(law: ContactLaw) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        step = law.close(system(3))
        y = ca.vertcat(*step.map(x, u, step.p.values))
        gradient = ca.Function("d", [x, u], [y, ca.jacobian(y, ca.vertcat(x, u))])
        mu = np.array(step.data(w[:3], w[3:], step.p.values)[4])
        value, jacobian = (np.array(v) for v in gradient(w[:3], w[3:]))
        return value, jacobian, mu

    total, frozen = evaluate(Adaptive(sigma=0.3)), evaluate(Adaptive(sigma=0.3, gradient="frozen"))
    held = evaluate(Adaptive(law=lambda z, F: ca.SX(ca.DM(total[2]))))
    assert np.allclose(frozen[0], total[0], atol=1e-14)
    assert np.allclose(frozen[1], held[1], atol=1e-12)
    # Far from contact mu and its derivative vanish, and so does the difference.
    assert np.max(total[2]) < 1e-3 or np.max(np.abs(frozen[1] - total[1])) > 1e-4


@pytest.mark.parametrize("name", problems.names()[:5])
@pytest.mark.parametrize("law", ["barrier", "gaussian"])
def test_every_problems_step(name, law):
    problem = problems.get(name)
    step = (Barrier(mu=1e-2) if law == "barrier" else Adaptive(sigma=0.2)).close(problem.system)
    nx, nu = problem.system.nx, problem.system.nu
    w = ca.MX.sym("w", nx + nu + len(step.p))
    y = ca.vertcat(*step.map(w[:nx], w[nx : nx + nu], w[nx + nu :]))
    evaluate = ca.Function("d", [w], [y, ca.jacobian(y, w)])
    start = problem.initial_states(problem.parameters.values)[0]
    at = np.concatenate([start, np.full(nu, 0.1), step.p.values])
    expected = difference(lambda v: np.array(evaluate(v)[0]).ravel(), at)
    assert np.allclose(np.array(evaluate(at)[1]), expected, rtol=1e-5, atol=1e-6)


def test_the_active_set_is_that_of_the_exact_solution():
    """The tip between soft walls 0.35 m to both sides touches only the wall that it is beyond."""
    step = Exact().close(get("cart-walls").system)
    p = step.p.values
    for theta, expected in ((0.8, [1, 0]), (-0.8, [0, 1]), (0.0, [0, 0])):
        x = [0.0, theta, 0.0, 0.0]
        _, lam, gap, _ = (np.array(v).ravel() for v in step.solve(x, [0.0], p))
        active = lam > gap
        assert active.astype(int).tolist() == expected
        assert np.all(lam[~active] == 0) and np.allclose(gap[active], 0, atol=1e-12)
