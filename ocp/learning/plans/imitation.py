"""Policies fitted to plans, to start from."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import minimize

from dynamics.batch import BatchFunction, DensePolicy, dense
from ocp.learning.network import first_weights
from ocp.learning.normaliser import Normaliser
from ocp.learning.plans.demonstrations import demonstrations
from ocp.learning.protocol import Trained
from ocp.solution import Solution
from ocp.task import Task

LARGEST = 0.99
"""Share of the way from the middle to a bound at which an input is cut, as no finite action reaches
a bound."""
_ITERATIONS = 500
_ROWS = 64
"""Rows of a product of matrices: those of all samples are shared among threads, which wait for one
another on a busy machine, 50 times as long as they work, and round by how many they are."""


def fit_policy(
    task: Task,
    plans: Sequence[Solution],
    hidden: tuple[int, ...] = (),
    seed: int = 0,
    *,
    copies: int = 0,
    spread: float = 0.0,
) -> Trained:
    """Fit a policy to the states and inputs of ``plans`` (:func:`demonstrations`).

    Raises :class:`~ocp.errors.InputError` as :func:`demonstrations` does.
    """
    return fit_actions(task, *demonstrations(plans, copies, spread, seed), hidden, seed)


def fit_actions(
    task: Task, states: np.ndarray, inputs: np.ndarray, hidden: tuple[int, ...] = (), seed: int = 0
) -> Trained:
    """The policy with tanh layers ``hidden`` that does ``inputs`` (n, nu) in ``states`` (n, nx).

    It minimises the mean of ``|a(o) - a*|²``, the action before tanh against
    ``a* = artanh((u - mid) / half)``, with u cut to 0.99 of its way to the bounds. Observations are
    normalised by their own mean and deviation. The affine policy, ``()``, is the solution of least
    norm; others are where 500 iterations of L-BFGS lead from weights out of the ``seed``.
    """
    policy = dense(task.observe, hidden, task.lower, task.upper)
    seen = BatchFunction(task.observe, "numpy", 1)(states, task.parameters.values)
    normaliser = Normaliser.identity(seen.shape[1]).after(seen)
    seen = (seen - normaliser.mean) / normaliser.scale
    middle, half = (task.upper + task.lower) / 2, (task.upper - task.lower) / 2
    wanted = np.arctanh(np.clip((inputs - middle) / half, -LARGEST, LARGEST))
    if not hidden:
        features = np.column_stack([seen, np.ones(len(seen))])
        found = np.linalg.lstsq(features, wanted)[0]
        return Trained(np.concatenate([found[:-1].T.ravel(), found[-1]]), normaliser)
    first = first_weights(policy.sizes, 1.0, np.random.default_rng(seed))
    found = minimize(
        squared_error, first, (policy, seen, wanted), "L-BFGS-B", jac=True,
        options={"maxiter": _ITERATIONS, "maxfun": 2 * _ITERATIONS},
    )  # fmt: skip
    return Trained(found.x, normaliser)


def squared_error(
    theta: np.ndarray, policy: DensePolicy, seen: np.ndarray, wanted: np.ndarray
) -> tuple[float, np.ndarray]:
    """Mean of ``|a - a*|²`` over normalised observations (n, n_o), and its gradient (n_theta,).

    ``wanted`` (n, n_a) are the actions a*.
    """
    error, slope = 0.0, np.zeros_like(theta)
    for at in range(0, len(seen), _ROWS):
        part = _summed(theta, policy, seen[at : at + _ROWS], wanted[at : at + _ROWS])
        error, slope = error + part[0], slope + part[1]
    return error / len(seen), slope / len(seen)


def _summed(
    theta: np.ndarray, policy: DensePolicy, seen: np.ndarray, wanted: np.ndarray
) -> tuple[float, np.ndarray]:
    """Sum of ``|a - a*|²`` and its gradient, back through the layers."""
    layers, values = policy.layers(theta), [seen]
    for weights, offsets in layers[:-1]:
        values.append(np.tanh(values[-1] @ weights.T + offsets))
    weights, offsets = layers[-1]
    off = values[-1] @ weights.T + offsets - wanted
    bar = 2 * off
    parts: list[np.ndarray] = []
    for (weights, _), before in zip(reversed(layers), reversed(values), strict=True):
        parts = [(bar.T @ before).ravel(), bar.sum(axis=0), *parts]
        bar = bar @ weights * (1 - before**2)
    return float((off**2).sum()), np.concatenate(parts)
