"""Environments of named tasks, as Gymnasium makes them."""

from __future__ import annotations

import gymnasium

from reports import environments

IDS = {task: name for name, task in environments.ENVIRONMENTS.items()}
SOFT = {"barrier": {"mu": 1e-3}, "adaptive": {"sigma": 0.05}, "randomized": {"samples": 4}}


def made(task: str, **given) -> gymnasium.Env:
    return gymnasium.make(IDS[task], **given)


def many(task: str, num_envs: int, **given) -> gymnasium.vector.VectorEnv:
    return gymnasium.make_vec(IDS[task], num_envs=num_envs, vectorization_mode="vector_entry_point", **given)
