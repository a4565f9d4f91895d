"""A rollout under mirrored (antithetic) noise equals the rollout at -w, bit for bit."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynamics.batch import Gaussian
from dynamics.contact import Barrier
from ocp.gradients.rollouts import RolloutObjective
from ocp.problem.policy import Feedback
from problems import get, names
from tests.examples import settings

HORIZON, SAMPLES = 3, 4
# Problems whose kernels take almost a minute to compile.
LARGE = ("hopper", "half-cheetah")
SPACE = ("quadruped", "ant", "push-cube", "reorient")
CASES = [
    pytest.param(name, backend, marks=[pytest.mark.slow] if name in SPACE else [])
    for name in names()
    for backend in (("numpy",) if name in LARGE + SPACE else ("numpy", "c"))
]


@functools.cache
def objective(name: str, backend: str) -> RolloutObjective:
    problem = get(name, N=HORIZON)
    return RolloutObjective(problem, Barrier(mu=1e-2), backend=backend)


@functools.cache
def sigma(name: str) -> np.ndarray:
    """Return a tenth of every input's scale, rounded to a power of 2, so that division by it is exact."""
    problem = get(name)
    scale = np.broadcast_to(problem.scaling.u, (problem.system.nu,))
    return 2.0 ** np.round(np.log2(0.1 * scale))


@pytest.mark.costly_cases("push-t-c")
@pytest.mark.one_case_in(9)
@pytest.mark.parametrize(("name", "backend"), CASES)
@settings(max_examples=5, deadline=None)
@given(seed=st.integers(0, 2**32))
def test_mirrored_costs_are_forward_costs_at_minus_w(name, backend, seed):
    """The open-loop score w / sigma^2 recovers the noise that the kernel has drawn."""
    f, noise = objective(name, backend), Gaussian(sigma(name), seed)
    straight, turned = f.sample_scores(noise, SAMPLES), f.sample_scores(noise.negate(), SAMPLES)
    np.testing.assert_array_equal(turned.direction, -straight.direction)
    w = straight.direction * np.tile(noise.component_scales(len(sigma(name))) ** 2, HORIZON)
    drawn = noise.draw(SAMPLES, HORIZON, len(sigma(name))).reshape(SAMPLES, -1)
    np.testing.assert_allclose(w, drawn, rtol=1e-12, atol=1e-15 * sigma(name).max())
    assert np.isfinite(turned.cost).all()
    np.testing.assert_array_equal(turned.cost, f.costs(-w))
    np.testing.assert_array_equal(straight.cost, f.costs(w))
    assert not np.any(turned.cost == straight.cost)


@pytest.mark.parametrize("order", ["cost", "zeroth", "first"])
def test_moments_and_gradients_of_mirrored_noise(order):
    """Fused moments draw -w too, and a continued stream stays mirrored."""
    f, noise, n = objective("planar-push", "c"), Gaussian(0.25, 5).negate(), 3000
    (found, bad) = f.moments(noise, n, order) or pytest.fail("no moments")
    assert not len(bad)
    parts = (f.sample_gradients if order == "first" else f.sample_scores)(noise, n)
    single = parts.cost[:, None]
    if order != "cost":
        single = parts.direction if order == "first" else single * parts.direction
    np.testing.assert_allclose(found.mean, single.mean(axis=0), rtol=1e-9)
    rest = f.sample_scores(noise.skip_samples(1000), 5)
    np.testing.assert_array_equal(rest.cost, f.sample_scores(noise, 1005).cost[1000:])


def test_perturbed_policies_are_pairs():
    """Evolution strategies perturb the gains by e and -e."""
    f = RolloutObjective(get("push-disc", N=HORIZON), Barrier(mu=1e-2), Feedback())
    noise = Gaussian(0.25, seed=2)
    straight, turned = f.sample_perturbed(noise, 6), f.sample_perturbed(noise.negate(), 6)
    np.testing.assert_array_equal(turned.direction, -straight.direction)
    names_of_theta = [signal.name for signal in f.decision]
    for cost, e in zip(turned.cost, straight.direction * 0.0625, strict=True):
        moved = f.at(dict(zip(names_of_theta, f.theta - e, strict=True)))
        np.testing.assert_array_equal(cost, moved.nominal_cost())
