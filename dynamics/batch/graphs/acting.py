"""Which noise acts: the ways from the noise of a step to the cost, as the step's graphs have them.

A score `w_t / sigma^2` whose noise does not reach the cost has mean zero beside it, and only adds
its variance. What is left out here is known not to act before it is drawn, so that no mean changes.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np


@dataclass(frozen=True)
class Ways:
    """Whether x_next and the cost of a step, rows, depend on x and on the noise w, columns.

    `by_x` (nx + 1, nx) and `by_w` (nx + 1, nu) go through contact and policy, whatever the values
    of state and parameters; `at_end` (nx,) is of the terminal cost. Noise j does nothing in states
    where any x_s with `gates` (nu, nx) is zero.
    """

    by_x: np.ndarray
    by_w: np.ndarray
    at_end: np.ndarray
    gates: np.ndarray

    def over(self, horizon: int) -> tuple[np.ndarray, np.ndarray]:
        """Whether w_t (horizon, nu) and x_{t+1} (horizon, nx) reach the cost of a rollout."""
        noise, states = [], [self.at_end]
        for _ in range(horizon):
            counts = np.append(states[-1], True)
            noise.append(counts @ self.by_w)
            states.append(counts @ self.by_x)
        return np.array(noise[::-1]), np.array(states[-2::-1])


def ways(outputs: ca.SX, terminal: ca.SX, x: ca.SX, w: ca.SX) -> Ways:
    """The ways of a step with `outputs` (x_next, cost) in (x, w), and `terminal` in x.

    Gates are looked for among states that no noise moves: others are zero by chance alone.
    """
    by_x, by_w = depends(outputs, x), depends(outputs, w)
    nx = x.numel()
    found = Ways(by_x, by_w, depends(terminal, x)[0], np.zeros((w.numel(), nx), dtype=bool))
    noise, states = found.over(nx + 1)
    still = ~by_w[:-1].any(axis=1)
    for _ in range(nx):
        still &= ~by_x[:-1, ~still].any(axis=1)
    rows = np.append(states.any(axis=0), True)
    for s in np.flatnonzero(still):
        shut = ca.substitute(outputs[np.flatnonzero(rows).tolist()], x[int(s)], 0)
        found.gates[:, s] = noise.any(axis=0) & ~depends(shut, w).any(axis=0)
    return found


def depends(expression: ca.SX, on: ca.SX) -> np.ndarray:
    """Which entries of an expression depend on which of the symbols `on`, as a Boolean table."""
    pattern = ca.jacobian_sparsity(ca.densify(expression), on)
    return np.array(ca.DM(pattern, 1).full(), dtype=bool).reshape(expression.numel(), on.numel())


def stand_ins(unknown: ca.SX, rows: ca.SX) -> ca.SX:
    """For each unknown something that depends on all that the unknown does.

    Unknown i solves `rows` i (n, 1), together with those that these rows tie it to.
    """
    n = unknown.numel()
    tied = depends(rows, unknown) | np.eye(n, dtype=bool)
    tied |= tied.T
    for _ in range(n.bit_length()):
        tied = tied @ tied
    own = ca.SX.sym("weight", n) * ca.substitute(rows, unknown, ca.SX.sym("free", n))
    return ca.DM(tied.astype(float)) @ own
