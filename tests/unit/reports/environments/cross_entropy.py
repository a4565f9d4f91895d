"""The cross-entropy method on any Gymnasium vector environment, independent of the workbench.

Rubinstein and Kroese, The Cross-Entropy Method, 2004.
"""

import numpy as np
from gymnasium.vector import VectorEnv


def episodes(env: VectorEnv, thetas: np.ndarray, seed: int | None = None) -> np.ndarray:
    """Return the returns (num_envs,) of one episode, with an affine policy for each environment."""
    observations, _ = env.reset(seed=seed)
    nu, returns, going = env.single_action_space.shape[0], np.zeros(env.num_envs), True
    gains = thetas.reshape(env.num_envs, nu, -1)
    while np.any(going):
        ones = np.ones((env.num_envs, 1))
        seen = np.concatenate([observations, ones], axis=1)
        actions = np.clip(np.einsum("nij,nj->ni", gains, seen), -1, 1)
        observations, rewards, terminated, truncated, _ = env.step(actions)
        returns += np.where(going, rewards, 0.0)
        going = going & ~(terminated | truncated)
    return returns


def cross_entropy(
    env: VectorEnv, generations: int, sigma: float, seed: int = 0, elite: float = 0.2
) -> tuple[np.ndarray, np.ndarray]:
    """Fit a normal distribution of policies to the best of each generation.

    Returns the returns (generations, num_envs) and the mean policy (n_theta,).
    """
    size = env.single_action_space.shape[0] * (env.single_observation_space.shape[0] + 1)
    mean, spread, rng = np.zeros(size), np.full(size, sigma), np.random.default_rng(seed)
    told = []
    for generation in range(generations):
        thetas = mean + spread * rng.standard_normal((env.num_envs, size))
        told.append(episodes(env, thetas, seed=seed + generation * env.num_envs))
        best = thetas[np.argsort(told[-1])[-max(2, int(elite * env.num_envs)) :]]
        mean, spread = best.mean(axis=0), best.std(axis=0) + 0.02 * sigma
    return np.array(told), mean
