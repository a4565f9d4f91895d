"""The backends agree with CasADi's function, and with one another, for drawn inputs."""

from __future__ import annotations

import functools

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from dynamics.batch import BatchFunction, Gaussian, RolloutFunction, affine_policy, open_loop
from dynamics.contact import Barrier
from tests.examples import settings
from tests.unit.dynamics.batch.backends import FAST
from tests.unit.dynamics.batch.rollout_cases import closed, four_contacts, reference, wall

VALUES = st.floats(-3.0, 3.0, allow_subnormal=False)
N = 4


@functools.cache
def function(backend: str, threads: int = 1, block: int = 32) -> BatchFunction:
    x, y = ca.SX.sym("x", 3), ca.SX.sym("y", 2)
    r = ca.sqrt(ca.sumsqr(x) + 1e-3)
    contact = ca.if_else(x[0] < y[0], ca.exp(-r), ca.fmax(x[1], y[1]) / (1 + r))
    angle = ca.atan2(x[1], 1.5 + ca.cos(x[2])) * ca.tanh(y[0])
    smooth = ca.erf(x[0]) + ca.fmin(ca.fabs(x[2]), ca.log1p(y[1] ** 2))
    total = contact + angle + smooth
    f = ca.Function("drawn", [x, y], [total, ca.gradient(total, x)])
    return BatchFunction(f, backend=backend, threads=threads, block=block)


@settings(max_examples=60, deadline=None)
@given(
    x=arrays(float, st.tuples(st.integers(1, 40), st.just(3)), elements=VALUES),
    y=arrays(float, 2, elements=VALUES),
)
def test_backends_agree_on_value_and_gradient(x, y):
    wanted = function("casadi")(x, y)
    for backend in FAST:
        for one, other in zip(function(backend)(x, y), wanted, strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-13)
    for threads, block in ((1, 8), (2, 8), (2, 64)):
        again = function("c", threads, block)(x, y)
        np.testing.assert_array_equal(again[1], function("c")(x, y)[1])


@functools.cache
def rollouts(system: str, policy: str):
    step, *costs = closed({"wall": wall, "four": four_contacts}[system](), Barrier(mu=1e-3))
    law = {"open": open_loop, "affine": affine_policy}[policy](step.system.nx, step.system.nu)
    made = {b: RolloutFunction(step, *costs, N, law, backend=b) for b in FAST}
    return step, law, made, reference(step, *costs, N, law)


@pytest.mark.costly_cases("four-open", "four-affine")
@pytest.mark.parametrize("policy", ["open", "affine"])
@pytest.mark.parametrize("system", ["wall", "four"])
@settings(max_examples=25, deadline=None)
@given(data=st.data())
def test_rollouts_agree_with_casadi(system, policy, data):
    step, law, made, wanted = rollouts(system, policy)
    nx, nu = step.system.nx, step.system.nu
    x0 = data.draw(arrays(float, nx, elements=VALUES), label="x0")
    theta = data.draw(arrays(float, law.shape(N), elements=VALUES), label="theta")
    w = data.draw(arrays(float, (N, nu), elements=VALUES), label="w")
    cost, gradient = wanted(x0, np.atleast_2d(theta).T, step.p.values, w.T)
    gradient = np.array(gradient).T.reshape(theta.shape)
    for f in made.values():
        got = f(x0, theta, noise=w[None])
        np.testing.assert_allclose(got.cost[0], float(cost), rtol=1e-12)
        scale = 1 + np.abs(gradient).max()
        np.testing.assert_allclose(got.gradient[0], gradient, rtol=1e-9, atol=1e-11 * scale)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**64), n=st.integers(1, 200), more=st.integers(0, 200))
def test_a_prefix_of_a_run_is_the_shorter_run(seed, n, more):
    _, _, made, _ = rollouts("wall", "open")
    x0, theta, noise = np.zeros(2), np.zeros((N, 1)), Gaussian(0.3, seed)
    long = made["c"](x0, theta, noise=noise, n_samples=n + more)
    short = made["c"](x0, theta, noise=noise, n_samples=n)
    np.testing.assert_array_equal(long.gradient[:n], short.gradient)
