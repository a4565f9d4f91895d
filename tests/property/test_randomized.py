"""Averages over noise agree with the closed form, and their nodes have the moments of the normal."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynamics.contact import Adaptive, Barrier, Exact, Randomized
from dynamics.contact.randomized import standard_normal_nodes
from dynamics.systems import ContactSystem, lcs
from tests.examples import settings

SAMPLED = ("sobol", "monte-carlo")


def pushed(nu: int = 1) -> ContactSystem:
    """Return a system x+ = x/2 + sum u + lam, gap = x + sum u + lam, whose contact the input closes."""
    row = np.ones((1, nu))
    return lcs("pushed", A=[[0.5]], B=row, C=[[1.0]], D=[[1.0]], E=row, F=[[1.0]])


def mean_step(law, x: float, u: float, nu: int = 1) -> float:
    step = law.close(pushed(nu))
    return float(step.solve(x, np.full(nu, u / nu), step.p.values)[0])


def smoothed_exact(x: float, u: float, sigma: float) -> float:
    """Return the exact step averaged over N(0, sigma²) on the gap, by the gaussian law's closed form."""
    return mean_step(Adaptive(sigma=sigma), x, u)


@pytest.mark.costly
@pytest.mark.parametrize("scheme", SAMPLED)
def test_the_average_approaches_the_closed_form_as_samples_grow(scheme):
    def error(samples: int, seed: int) -> float:
        step = Randomized(0.5, samples, seed, scheme).close(pushed())
        off = [float(step.solve(x, 0.1, step.p.values)[0]) - smoothed_exact(x, 0.1, 0.5) for x in (-0.4, 0.0, 0.3)]
        return float(np.mean(np.abs(off)))

    errors = [np.mean([error(samples, seed) for seed in range(3)]) for samples in (16, 128, 1024)]
    assert errors[2] < errors[1] < errors[0]
    assert errors[2] < (0.02 if scheme == "monte-carlo" else 2e-3)


def test_the_hermite_rule_is_exact_for_smooth_steps():
    # Softened contact is analytic, so that the rule converges fast, to the values of a finer one.
    values = [
        mean_step(Randomized(0.2, n, scheme="gauss-hermite", base=Barrier(mu=0.3)), 0.1, 0.05) for n in (3, 7, 20, 40)
    ]
    off = np.abs(np.array(values[:-1]) - values[-1])
    assert off[0] < 1e-2
    assert off[1] < 1e-4
    assert off[2] < 1e-8


@pytest.mark.costly
def test_noise_on_the_state_reaches_the_whole_step():
    # With x+ = x/2 + ..., noise on x and on u differ only in the part without contact.
    on_state = mean_step(Randomized(0.3, 256, noise="state"), -0.2, 0.1)
    on_input = mean_step(Randomized(0.3, 256, noise="input"), -0.2, 0.1)
    assert on_state == pytest.approx(on_input, abs=1e-12)  # the mean of the smooth part is zero
    step = Randomized(0.3, 4, noise="state").close(pushed())
    gaps = np.array(step.data(-0.2, 0.1, step.p.values)[2]).ravel()
    assert len(set(np.round(gaps, 12))) == 4


@pytest.mark.costly
def test_several_noisy_inputs_add_up():
    # Two inputs with noise sigma each move the gap like one with sqrt(2) sigma.
    both = mean_step(Randomized(0.3, 2048, seed=2), 0.1, 0.1, nu=2)
    assert both == pytest.approx(smoothed_exact(0.1, 0.1, 0.3 * np.sqrt(2)), abs=1e-3)


@settings(max_examples=30)
@given(
    dimension=st.integers(1, 5),
    half=st.integers(1, 40),
    seed=st.integers(0, 2**31 - 1),
    scheme=st.sampled_from(SAMPLED),
)
def test_drawn_nodes_repeat_and_have_no_odd_moments(dimension, half, seed, scheme):
    nodes, weights = standard_normal_nodes(dimension, 2 * half, seed, scheme)
    again, _ = standard_normal_nodes(dimension, 2 * half, seed, scheme)
    other, _ = standard_normal_nodes(dimension, 2 * half, seed + 1, scheme)
    assert nodes.shape == (2 * half, dimension)
    assert np.array_equal(nodes, again)
    assert not np.array_equal(nodes, other)
    assert np.all(np.isfinite(nodes))
    assert weights.sum() == pytest.approx(1)
    for power in (1, 3):
        assert np.allclose(weights @ nodes**power, 0, atol=1e-12 * (1 + np.abs(nodes).max() ** 3))


@settings(max_examples=20)
@given(dimension=st.integers(1, 3), samples=st.integers(2, 12))
def test_the_hermite_rule_has_the_moments_of_the_normal(dimension, samples):
    nodes, weights = standard_normal_nodes(dimension, samples, 0, "gauss-hermite")
    assert nodes.shape == (samples**dimension, dimension)
    assert np.allclose(weights @ nodes, 0, atol=1e-12)
    assert np.allclose((weights[:, None] * nodes).T @ nodes, np.eye(dimension), atol=1e-10)
    if samples >= 3:
        assert np.allclose(weights @ nodes**4, 3)


@pytest.mark.parametrize("scheme", SAMPLED)
def test_drawn_nodes_spread_like_a_normal(scheme):
    nodes, weights = standard_normal_nodes(2, 2048, 5, scheme)
    assert np.allclose((weights[:, None] * nodes).T @ nodes, np.eye(2), atol=0.1)
    assert np.mean(np.abs(nodes) < 1) == pytest.approx(0.6827, abs=0.03)


def test_without_noise_the_average_is_the_base_law():
    for base in (Exact(), Barrier(mu=0.01), Adaptive(law="quartic")):
        step = base.close(pushed())
        plain = float(step.map(0.1, -0.4, step.p.values)[0])
        assert mean_step(Randomized(1e-9, 8, base=base), 0.1, -0.4) == pytest.approx(plain, abs=1e-8)


def test_the_same_seed_gives_the_same_step():
    first, second, other = (mean_step(Randomized(0.3, 8, seed), 0.1, -0.2) for seed in (3, 3, 4))
    assert first == second
    assert first != other
