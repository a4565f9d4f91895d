"""Guessed trajectories: the problem's own, perturbed ones, and what they do when rolled out."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from dynamics.contact import Step
from ocp.problem import Problem
from ocp.rollout import Rollout, roll_on

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


def rolled_guesses(
    problem: Problem, step: Step, values: dict[str, float], count: int, first: Guessed | None
) -> Iterator[Rollout]:
    """Inputs of guesses, seed 0, rolled out under a step; those that it solves."""
    for X, U in guesses(problem, values, count, 0, first):
        rolled, unsolved = roll_on(problem, U[None], values, step, X[None, 0])
        if unsolved is None and np.all(np.isfinite(rolled.x)):
            yield rolled
