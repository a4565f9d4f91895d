"""An algorithm that uses only Gymnasium's interface learns on the vector environments."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest
from scipy.stats import mannwhitneyu

from reports import environments
from tests.unit.reports.environments.cross_entropy import cross_entropy, episodes

assert environments.ENVIRONMENTS


def better(later: np.ndarray, earlier: np.ndarray) -> float:
    """Return the p-value of a one-sided rank-sum test that later returns are better than earlier ones."""
    return float(mannwhitneyu(later, earlier, alternative="greater").pvalue)


@pytest.mark.costly
def test_throws_learn_to_reach_the_goal():
    env = gymnasium.make_vec("centralpath/BallThrow-v0", num_envs=64)
    returns, mean = cross_entropy(env, generations=15, sigma=0.5)
    assert better(returns[-1], returns[0]) < 1e-9
    # Throws of the first generation miss by metres; the learned one misses by centimetres.
    assert returns[0].mean() < -5
    learned = episodes(env, np.tile(mean, (64, 1)))
    assert -0.01 < learned[0] < 0
    # The same number of random throws is much farther off on average.
    chance = np.random.default_rng(1).normal(0, 0.5, (64, mean.size))
    assert better(np.full(64, learned[0]), episodes(env, chance)) < 1e-6


@pytest.mark.costly
def test_a_hopper_learns_to_jump_forward_before_it_falls():
    env = gymnasium.make_vec("centralpath/Hopper-v0", num_envs=64)
    returns, mean = cross_entropy(env, generations=15, sigma=0.1)
    assert better(returns[-1], returns[0]) < 1e-12
    # Starts differ from those of learning.
    unseen = episodes(env, np.tile(mean, (64, 1)), seed=10_000)
    assert better(unseen, episodes(env, np.zeros((64, mean.size)), seed=10_000)) < 1e-12
    assert unseen.mean() > 5 > 2 > returns[0].mean()


@pytest.mark.slow
def test_a_half_cheetah_learns_to_run():
    env = gymnasium.make_vec("centralpath/HalfCheetah-v0", num_envs=64)
    returns, mean = cross_entropy(env, generations=15, sigma=0.1)
    assert better(returns[-1], returns[0]) < 1e-12
    # A return of 75 over 100 steps means at least 0.75 m/s, since effort only costs.
    unseen = episodes(env, np.tile(mean, (64, 1)), seed=10_000)
    assert unseen.mean() > 75 > 0 > returns[0].mean()
