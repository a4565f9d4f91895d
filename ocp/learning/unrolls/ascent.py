"""Steps uphill along noisy gradients, with what they remember held in the algorithm's state."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from ocp.errors import choose
from ocp.learning.protocol import State

Slope = Callable[[np.ndarray], tuple[float, np.ndarray]]
"""Maps parameters to a cost and its gradient, which may be a sample of it."""

DECAY = (0.9, 0.999)


def adam_step(
    gradient: np.ndarray, m: np.ndarray, v: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Step ``count`` = 1, 2, ... at rate 1, and the next m and v (Kingma and Ba, algorithm 1).

    ``m <- b1 m + (1 - b1) g``, ``v <- b2 v + (1 - b2) g²`` and the step
    ``m/(1 - b1^t) / (sqrt(v/(1 - b2^t)) + 1e-8)``, b1, b2 = 0.9, 0.999.
    """
    m = DECAY[0] * m + (1 - DECAY[0]) * gradient
    v = DECAY[1] * v + (1 - DECAY[1]) * gradient**2
    first, second = m / (1 - DECAY[0] ** count), v / (1 - DECAY[1] ** count)
    return first / (np.sqrt(second) + 1e-8), m, v


def adam(slope: Slope, theta: np.ndarray, rate: float) -> Iterator[tuple[np.ndarray, float]]:
    """Give theta and its cost, before each step down by ``rate``, for ever.

    Raises ``ValueError`` where a gradient is not finite.
    """
    theta = np.array(theta, dtype=float)
    m, v = np.zeros_like(theta), np.zeros_like(theta)
    count = 0
    while True:
        cost, gradient = slope(theta)
        yield theta.copy(), cost
        if not np.isfinite(gradient).all():
            raise ValueError(f"adam: the gradient of step {count} is not finite; lower the rate")
        count += 1
        step, m, v = adam_step(gradient, m, v, count)
        theta -= rate * step


LIMIT = 1e3
"""Largest entry of a gradient that normalised ascent follows."""

Rule = Callable[[State, np.ndarray, float], State]
"""Maps (state, gradient, rate) to the entries of the state that change, ``theta`` among them."""


def ascend(rule: str, state: State, gradient: np.ndarray, rate: float) -> State:
    """State after a step from its ``theta`` along ``gradient``, both (n_theta,).

    ``adam`` is Kingma and Ba's; ``normalised`` is ``theta + rate g / |g|_inf``, and stays where
    |g|_inf is 1000 or more (Dojo's augmented gradient search); ``plain`` is ``theta + rate g``, of
    abs, eq. 4.3. Raises :class:`~ocp.errors.InputError` for another ``rule``.
    """
    return {**state, **choose("optimiser", rule, RULES)(state, gradient, rate)}


def _adam(state: State, gradient: np.ndarray, rate: float) -> State:
    zero = np.zeros_like(gradient)
    m, v, count = state.get("adam.m", zero), state.get("adam.v", zero), state.get("adam.count", 0)
    step, m, v = adam_step(gradient, m, v, int(count) + 1)
    return {
        "theta": state["theta"] + rate * step,
        "adam.m": m,
        "adam.v": v,
        "adam.count": np.array(int(count) + 1),
    }


def _normalised(state: State, gradient: np.ndarray, rate: float) -> State:
    size = np.abs(gradient).max(initial=0.0)
    step = gradient / size if 0 < size < LIMIT else 0.0 * gradient
    return {"theta": state["theta"] + rate * step}


def _plain(state: State, gradient: np.ndarray, rate: float) -> State:
    return {"theta": state["theta"] + rate * gradient}


RULES: dict[str, Rule] = {"adam": _adam, "normalised": _normalised, "plain": _plain}
