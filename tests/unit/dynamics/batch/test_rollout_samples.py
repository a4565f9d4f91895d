"""Samples of rollouts: noise, scores, moments, and samples that are not finite."""

from __future__ import annotations

import warnings

import casadi as ca
import numpy as np
import pytest

from dynamics.batch import BatchWarning, Gaussian, RolloutFunction, open_loop
from tests.unit.dynamics.batch.backends import BACKENDS, FAST
from tests.unit.dynamics.batch.test_rollout import HORIZON, case, inputs, rollout


@pytest.mark.parametrize("backend", FAST)
def test_first_samples_of_a_larger_run_are_the_same(backend):
    f = rollout("wall", "barrier", "open", backend)
    x0, theta = np.zeros(2), np.zeros((HORIZON, 1))
    many = f(x0, theta, noise=Gaussian(0.2, seed=1), n_samples=3000)
    few = f(x0, theta, noise=Gaussian(0.2, seed=1), n_samples=37)
    rest = f(x0, theta, noise=Gaussian(0.2, seed=1, first=37), n_samples=100)
    np.testing.assert_array_equal(many.cost[:37], few.cost)
    np.testing.assert_array_equal(many.gradient[37:137], rest.gradient)


@pytest.mark.parametrize("backend", BACKENDS)
def test_fused_noise_is_the_noise_that_numpy_draws(backend):
    f = rollout("four", "barrier", "affine", backend)
    given = inputs(f, 50)
    noise = Gaussian(np.array([0.1, 0.3]), seed=9)
    fused = f(**{**given, "noise": noise}, score=True)
    drawn = noise.draw(50, HORIZON, 2)
    np.testing.assert_allclose(fused.cost, f(**{**given, "noise": drawn}).cost, rtol=1e-12)


@pytest.mark.parametrize("backend", BACKENDS)
def test_score_is_the_gradient_of_the_log_density(backend):
    sigma = np.array([0.1, 0.3])
    f = rollout("four", "barrier", "open", backend)
    noise = Gaussian(sigma, seed=2)
    got = f(np.zeros(6), np.zeros((HORIZON, 2)), noise=noise, n_samples=20, score=True)
    wanted = noise.draw(20, HORIZON, 2) / sigma**2
    np.testing.assert_allclose(got.score, wanted, rtol=1e-12, atol=1e-12)

    # For affine feedback on a linear system without contact the score is a sum over the states.
    f = rollout("four", "barrier", "affine", backend)
    got = f(np.ones(6), np.zeros(14), noise=noise, n_samples=20, score=True)
    offsets = got.score[:, 12:]
    np.testing.assert_allclose(offsets, wanted.sum(axis=1), rtol=1e-10, atol=1e-10)


@pytest.mark.costly_cases("affine-c")
@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("policy", ["open", "affine"])
def test_moments_are_those_of_the_samples(policy, backend):
    f = rollout("wall", "barrier", policy, backend)
    given = inputs(f, 1) | {"noise": Gaussian(0.3, seed=7)}
    given = {**given, "x0": given["x0"][0], "theta": given["theta"][0]}
    n = 6001 if backend != "casadi" else 500
    samples = f(**given, n_samples=n, score=True)
    moments = f.moments(**given, n_samples=n, score=True, baseline=1.5)
    gain = (samples.cost - 1.5).reshape(-1, *[1] * (samples.score.ndim - 1))
    pairs = [
        (moments.value, samples.cost),
        (moments.gradient, samples.gradient),
        (moments.zeroth, gain * samples.score),
    ]
    for kept, values in pairs:
        assert kept.n == n
        scale = np.abs(values).max()
        np.testing.assert_allclose(kept.mean, values.mean(axis=0), rtol=1e-10, atol=1e-13 * scale)
        np.testing.assert_allclose(kept.variance, values.var(axis=0, ddof=1), rtol=1e-9)
    assert moments.gradient.mean.shape == f.policy.shape(HORIZON)


def test_moments_survive_a_large_mean():
    # The cost is 1e8 plus a small number, so that a sum of squares would lose the variance.
    step = case("wall", "barrier")[0]
    x, p = step.system.x, step.p.vector
    terminal = ca.Function("terminal", [x, p], [1e8 + x[0]])
    nothing = ca.Function("nothing", [x, step.system.u, p], [ca.SX(0)])
    f = RolloutFunction(step, nothing, terminal, HORIZON, open_loop(2, 1))
    given = {"x0": np.array([5.0, 0.0]), "theta": np.zeros((HORIZON, 1))}
    noise = Gaussian(1.0, seed=0)
    moments = f.moments(**given, noise=noise, n_samples=20_000)
    costs = f(**given, noise=noise, n_samples=20_000).cost
    np.testing.assert_allclose(moments.value.variance, costs.var(ddof=1), rtol=1e-6)


@pytest.mark.costly_cases("casadi")
@pytest.mark.parametrize("backend", BACKENDS)
def test_non_finite_samples_are_named_and_left_out_of_moments(backend):
    f = rollout("wall", "barrier", "open", backend)
    given = inputs(f, 5003)
    given["x0"][[3, 4097, 5002], 0] = np.nan, np.inf, -np.inf
    message = "3 non-finite samples, at index 3, 4097, 5002"
    with pytest.warns(BatchWarning, match=message):
        samples = f(**given)
    np.testing.assert_array_equal(samples.nonfinite.indices, [3, 4097, 5002])
    with pytest.warns(BatchWarning, match=message + "; left out"):
        moments = f.moments(**given)
    np.testing.assert_array_equal(moments.nonfinite.indices, [3, 4097, 5002])
    kept = np.delete(samples.cost, [3, 4097, 5002])
    assert moments.value.n == 5000
    np.testing.assert_allclose(moments.value.mean, kept.mean(), rtol=1e-12)


def test_nan_ends_the_inner_loop_and_spoils_no_neighbour():
    f = rollout("four", "barrier", "open")
    given = inputs(f, 16)
    clean = f(**given)
    given["x0"][5, 2] = np.nan
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BatchWarning)
        spoiled = f(**given)
    others = np.arange(16) != 5
    np.testing.assert_array_equal(spoiled.cost[others], clean.cost[others])
    assert np.isnan(spoiled.cost[5])
