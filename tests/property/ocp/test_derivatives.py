"""The assembled derivatives are those of the assembled function, at any point."""

from __future__ import annotations

import functools
import math

import casadi as ca
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from dynamics.contact import Adaptive
from ocp.problem.policy import OpenLoop
from ocp.programs.program import PENALTY, RELAXATION
from ocp.routes.session import Session
from problems import get
from tests.examples import settings
from tests.unit.ocp.cases import (
    CASES,
    METHODS,
    directions,
    full,
    numerical,
    off,
    point,
    session,
    upper_to_full,
)

SHOOTING = ("multiple-shooting", "single-shooting")
few = settings(max_examples=5, deadline=None)
points = given(seed=st.integers(0, 2**32 - 1), spread=st.floats(1e-3, 0.3))


@functools.cache
def automatic(case: str, method: str, reformulation: str = "product") -> ca.Function:
    """Return CasADi's own derivatives of ``f_g``: gradient, Jacobian, Hessian of s f + m' g."""
    nlp = session(case, method).nlp_of(reformulation)
    x, p = ca.MX.sym("x", nlp.n), ca.MX.sym("p", len(nlp.names) + nlp.data.size)
    s, m = ca.MX.sym("s"), ca.MX.sym("m", nlp.m)
    f, g = nlp.f_g(x, p)
    hessian = ca.hessian(s * f + ca.dot(m, g), x)[0]
    return ca.Function("ad", [x, p, s, m], [ca.gradient(f, x), ca.jacobian(g, x), hessian])


def parameters(found: Session, reformulation: str = "product") -> np.ndarray:
    values = {**found.values, PENALTY: 3.0, RELAXATION: 0.1}
    return found.nlp_of(reformulation).parameter_vector(values)


def multipliers(size: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed + 1).standard_normal(size)


def check_automatic(case: str, reformulation: str, seed: int, spread: float) -> None:
    found = session(case, "direct")
    nlp, p = found.nlp_of(reformulation), parameters(found, reformulation)
    x, m = point(found, seed, spread, reformulation), multipliers(nlp.m, seed)
    gradient, jacobian, hessian = automatic(case, "direct", reformulation)(x, p, 0.7, m)
    assert nlp.m > 0 and np.abs(np.array(hessian)).max() > 0.1
    assert off(nlp.gradient(x, p)[1], gradient) < 1e-12
    assert off(nlp.jacobian(x, p)[1], jacobian) < 1e-12
    assert off(upper_to_full(nlp.hessian(x, p, 0.7, m)), hessian) < 1e-12


@pytest.mark.one_case_in(4)
@pytest.mark.parametrize("case", [case for case in CASES if case != "exact"])
@few
@points
def test_direct_equals_automatic_differentiation(case: str, seed: int, spread: float) -> None:
    check_automatic(case, "product", seed, spread)


@pytest.mark.parametrize("reformulation", ["none", "fischer-burmeister", "lin-fukushima"])
@few
@points
def test_every_form_of_direct_equals_automatic_differentiation(reformulation: str, seed: int, spread: float) -> None:
    check_automatic("exact", reformulation, seed, spread)


def switching(found: Session, x: np.ndarray, p: np.ndarray) -> float:
    """Return the distance to the nearest change of the active set, where the exact law has a kink."""
    nlp = found.nlp_of("product")
    if nlp.trajectories is not None:
        _, _, lam, gap = (np.array(v) for v in nlp.trajectories(x, p))
        return float(np.abs(lam - gap).min())
    states = nlp.variables.unpack(x)
    x0 = nlp.data.unpack(p[len(nlp.names) :])["x0"]
    before = np.concatenate([x0[:, None], states["x"]], axis=1)[:, :-1]
    inputs = np.broadcast_to(states["u"], (*before.shape[:2], states["u"].shape[2]))
    p = [found.values[name] for name in found.step.p.names]
    flat = (before.reshape(-1, before.shape[2]).T, inputs.reshape(-1, inputs.shape[2]).T)
    _, lam, gap, _ = (np.array(v) for v in found.step.solve.map(flat[0].shape[1])(*flat, p))
    return float(np.abs(lam - gap).min())


@pytest.mark.one_case_in(11)
@pytest.mark.parametrize("method", SHOOTING)
@pytest.mark.parametrize("case", CASES)
@few
@points
def test_shooting_equals_differences(case: str, method: str, seed: int, spread: float) -> None:
    found = session(case, method)
    nlp, p = found.nlp_of("product"), parameters(found)
    x, m = point(found, seed, spread), multipliers(nlp.m, seed)
    if found.step.exact:
        assume(switching(found, x, p) > 2e-3)

    def values(x: np.ndarray) -> np.ndarray:
        return np.concatenate([full(v).ravel() for v in nlp.f_g(x, p)])

    def slope(x: np.ndarray) -> np.ndarray:
        gradient = full(nlp.gradient(x, p)[1]).ravel()
        return 0.7 * gradient + full(nlp.jacobian(x, p)[1]).T @ m

    D = directions(nlp.n, seed)
    first = numerical(values, x, D)
    assert off(full(nlp.gradient(x, p)[1]).T @ D, first[:1]) < 1e-6
    assert off(full(nlp.jacobian(x, p)[1]) @ D, first[1:]) < 1e-6
    hessian = upper_to_full(nlp.hessian(x, p, 0.7, m))
    assert np.abs(hessian).max() > 0.1
    assert off(hessian @ D, numerical(slope, x, D)) < 1e-6


@pytest.mark.one_case_in(3)
@pytest.mark.parametrize("method", ("direct", *SHOOTING))
@pytest.mark.parametrize("case", CASES)
def test_value_and_derivative_functions_agree_on_values(case: str, method: str) -> None:
    found = session(case, method)
    nlp, p, x = found.nlp_of("product"), parameters(found), point(found, 4, 0.1)
    f, g = nlp.f_g(x, p)
    assert off(nlp.gradient(x, p)[0], f) < 1e-13
    assert off(nlp.jacobian(x, p)[0], g) < 1e-13


@pytest.mark.parametrize("method", SHOOTING)
def test_a_frozen_gradient_is_another_one_than_the_total(method: str) -> None:
    """For one step at z, ``d lam/d u`` with fixed mu is lam/(s + F lam), s the gap."""
    found = Session(
        get("push-1d", N=1, qa0=-0.2),
        Adaptive(sigma=0.1, gradient="frozen"),
        METHODS[method],
        OpenLoop(),
    )
    nlp, (u, h, M, K, sigma) = found.nlp_of("product"), (-0.15, 0.1, 1.0, 100.0, 0.1)
    F, z = h / M + 1 / (h * K), 0.0 - u - 0.2
    pdf = np.exp(-0.5 * (z / sigma) ** 2) / np.sqrt(2 * np.pi)
    tail = 0.5 * (1 - math.erf(z / sigma / np.sqrt(2)))
    lam = (sigma * pdf - z * tail) / F
    held = lam / (z + 2 * F * lam)
    p = nlp.parameter_vector(found.values)
    if method == "multiple-shooting":
        x = nlp.variables.pack({"u": np.array([u])})
        slope = -full(nlp.jacobian(x, p)[1])[nlp.constraints["dynamics"].index[0, 0, 0]]
        assert slope[nlp.variables["u"].index.ravel()[0]] == pytest.approx(h / M * held, rel=1e-8)
    else:
        end = h / M * lam
        expected = 200 * (end - 1) * h / M * held + 0.2 * (u + 0.2)
        assert full(nlp.gradient(np.array([u]), p)[1])[0, 0] == pytest.approx(expected, rel=1e-8)
