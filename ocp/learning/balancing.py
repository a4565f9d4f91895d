"""Policies to start from that keep a system at rest: linear feedback about a state."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np

from dynamics.batch import StepFunction
from dynamics.contact import Barrier
from ocp.errors import InputError
from ocp.task import Task

_WEIGHT = 1e-3
_STEPS = 1000
_STILL = 1e-2
_SMALL = 0.1


def balancing_feedback(task: Task, rest: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """W (nu, n_o) and b (nu,) of ``a = W o + b``, which keeps ``task`` at ``rest`` (nx,).

    The linear-quadratic regulator of the sharp step, mu = 1e-10, linearised at the state with the
    inputs in their middle, for the cost ``1e-3 |C (x - rest)|² + |a|²``, C the derivative of what
    is observed: nearly the feedback of least effort that is stable at all.

    Raises :class:`~ocp.errors.InputError` where the system does not rest there, or no feedback on
    what is observed keeps it.
    """
    if np.shape(rest) != (task.system.nx,) or not np.isfinite(rest).all():
        raise InputError(
            f"rest must be {task.system.nx} finite numbers, a state of {task.name}, got"
            f" {np.shape(rest)}"
        )
    step = Barrier(mu=1e-10).close(replace(task.system, parameters=task.parameters))
    middle, half = (task.upper + task.lower) / 2, (task.upper - task.lower) / 2
    stepped, by_x, by_u = StepFunction(step, "casadi", 1).slopes(rest[None], middle[None])
    moved = np.abs(stepped.x_next[0] - rest).max()
    if not moved < _STILL:
        raise InputError(f"{task.name} does not rest at the state given: a step moves it {moved:g}")
    x, p = task.system.x, task.parameters.vector
    observation = task.observe(x, p)
    look = ca.Function("look", [x, p], [observation, ca.densify(ca.jacobian(observation, x))])
    seen, C = (np.array(part) for part in look(rest, task.parameters.values))
    gain = _regulator(by_x[0], by_u[0] * half, _WEIGHT * C.T @ C)
    W = -gain @ np.linalg.pinv(C)
    if np.abs(W @ C + gain).max() > 1e-6 * np.abs(gain).max():
        raise InputError(f"{task.name} cannot be kept at rest by what is observed alone")
    return W, -W @ seen[:, 0]


def embed_affine(W: np.ndarray, b: np.ndarray, layers: list[tuple[np.ndarray, np.ndarray]]) -> None:
    """Make a network's ``layers`` (views of its parameters) compute ``W o + b`` nearly.

    The first units of each hidden layer carry a tenth of it, where tanh hardly bends; the last
    layer listens to no others. Raises :class:`~ocp.errors.InputError` for layers with fewer units
    than there are inputs.
    """
    n, (*hidden, last) = len(b), layers
    if not hidden:
        last[0][...], last[1][...] = W, b
        return
    if any(len(offsets) < n for _, offsets in hidden):
        raise InputError(f"a policy that balances needs hidden layers of at least {n} units")
    for place, (weights, offsets) in enumerate(hidden):
        weights[:n], offsets[:n] = (_SMALL * W, _SMALL * b) if place == 0 else (0.0, 0.0)
        if place:
            weights[:n, :n] = np.eye(n)
    last[0][...], last[1][...] = 0.0, 0.0
    last[0][:, :n] = np.eye(n) / _SMALL


def _regulator(A: np.ndarray, B: np.ndarray, Q: np.ndarray) -> np.ndarray:
    """K of ``a = -K x`` that is best over many steps of ``x+ = A x + B a``, by Riccati's steps."""
    P, K, one = Q, np.zeros((B.shape[1], len(A))), np.eye(B.shape[1])
    for _ in range(_STEPS):
        K = np.linalg.solve(one + B.T @ P @ B, B.T @ P @ A)
        P = Q + A.T @ P @ (A - B @ K)
    return K
