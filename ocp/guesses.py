"""Guessed trajectories: the problem's own, and perturbed ones."""

from __future__ import annotations

import numpy as np

from ocp.problem import Problem

_SPREAD = 0.3
Guessed = tuple[np.ndarray, np.ndarray]
"""States (N+1, nx) and inputs (N, nu)."""


def guesses(
    problem: Problem, values: dict[str, float], count: int, seed: int, first: Guessed | None = None
) -> list[Guessed]:
    """Return the problem's own guess, or ``first``, and perturbed ones, ``count`` in all.

    These are moved by noise of 0.3 characteristic units, each from its own stream of the seed.
    """
    physical = problem.parameters.pack(values)
    X, U = first if first is not None else problem.initial_guess(physical)
    found, sizes = [(X, U)], problem.sizes
    for stream in np.random.SeedSequence(seed).spawn(count - 1):
        noise = np.random.default_rng(stream)
        shaken = X + _SPREAD * sizes.x * noise.standard_normal(X.shape)
        shaken[0] = X[0]
        found.append((shaken, U + _SPREAD * sizes.u * noise.standard_normal(U.shape)))
    return found
