"""Steps uphill along noisy gradients, with what they remember held in the algorithm's state."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ocp.errors import choose
from ocp.learning.adam import adam_step
from ocp.learning.protocol import State

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
