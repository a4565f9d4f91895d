"""The graphs of one step of a rollout that engines evaluate, and the noise that affects the cost.

If noise does not affect the cost, the cost times the score `w_t / sigma^2` has mean zero and only
adds variance. Which noise is left out depends on the graphs alone, not on the drawn values, so that no
mean changes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import ClassVar

import casadi as ca
import numpy as np

from dynamics.batch.graphs.inner import InnerLoop
from dynamics.contact.learned_step import LearnedMap


@dataclass(frozen=True)
class CostDependence:
    """Boolean tables: which of x_next and the cost of a step depend on x and on the noise w.

    `by_x` (nx + 1, nx) and `by_w` (nx + 1, nu) have a row for each entry of x_next and one for the
    cost, and include the dependence through contact and policy for any values of state and
    parameters; `at_end` (nx,) is the dependence of the terminal cost on x. Noise j has no effect in a state x if x_s
    = 0 for some s with `gates[j, s]` (nu, nx).
    """

    by_x: np.ndarray
    by_w: np.ndarray
    at_end: np.ndarray
    gates: np.ndarray

    def masks(self, horizon: int) -> tuple[np.ndarray, np.ndarray]:
        """Return masks of the entries of w_t (horizon, nu) and x_{t+1} (horizon, nx) that affect a rollout's cost."""
        noise_reaches, state_reaches = [], [self.at_end]
        for _ in range(horizon):
            reaches_cost = np.append(state_reaches[-1], True)
            noise_reaches.append(reaches_cost @ self.by_w)
            state_reaches.append(reaches_cost @ self.by_x)
        return np.array(noise_reaches[::-1]), np.array(state_reaches[-2::-1])


def cost_dependence(outputs: ca.SX, terminal: ca.SX, x: ca.SX, w: ca.SX) -> CostDependence:
    """Return the dependence of a step with `outputs` (x_next, cost) in (x, w), and `terminal` cost in x.

    Only states that no noise changes can be gates; other states are almost never zero.
    """
    by_x, by_w = dependence_table(outputs, x), dependence_table(outputs, w)
    nx = x.numel()
    dependence = CostDependence(by_x, by_w, dependence_table(terminal, x)[0], np.zeros((w.numel(), nx), dtype=bool))
    noise_reaches, state_reaches = dependence.masks(nx + 1)
    is_noiseless = ~by_w[:-1].any(axis=1)
    for _ in range(nx):
        is_noiseless &= ~by_x[:-1, ~is_noiseless].any(axis=1)
    needed_rows = np.append(state_reaches.any(axis=0), True)
    for s in np.flatnonzero(is_noiseless):
        outputs_at_zero = ca.substitute(outputs[np.flatnonzero(needed_rows).tolist()], x[int(s)], 0)
        dependence.gates[:, s] = noise_reaches.any(axis=0) & ~dependence_table(outputs_at_zero, w).any(axis=0)
    return dependence


def dependence_table(expression: ca.SX, symbols: ca.SX) -> np.ndarray:
    """Return a Boolean table: which entries of an expression (rows) depend on which symbols (columns)."""
    pattern = ca.jacobian_sparsity(ca.densify(expression), symbols)
    return np.array(ca.DM(pattern, 1).full(), dtype=bool).reshape(expression.numel(), symbols.numel())


def stand_ins(unknown: ca.SX, rows: ca.SX) -> ca.SX:
    """Return, for each unknown (n, 1), an expression with the same dependencies as the solution of `rows` (n, 1) = 0.

    Unknown i depends on all symbols in row i and in the rows that are coupled to it.
    """
    n = unknown.numel()
    are_coupled = dependence_table(rows, unknown) | np.eye(n, dtype=bool)
    are_coupled |= are_coupled.T
    for _ in range(n.bit_length()):
        are_coupled = are_coupled @ are_coupled
    mixed_rows = ca.SX.sym("weight", n) * ca.substitute(rows, unknown, ca.SX.sym("free", n))
    return ca.DM(are_coupled.astype(float)) @ mixed_rows


@dataclass(frozen=True)
class Layers:
    """Dense layers of `sizes` between the observation and the mean action, with the observation's graphs.

    `n_weights` counts the weights and offsets of all layers.

    - `observe: (x, p) -> o`
    """

    sizes: tuple[int, ...]
    n_weights: int
    observe: ca.Function


def layer_slices(sizes: Sequence[int]) -> list[tuple[slice, slice, tuple[int, int]]]:
    """Return, for each layer, the slices of theta with its weights and its offsets, and the shape of the weights."""
    slices, start = [], 0
    for size_in, size_out in pairwise(sizes):
        middle, end = start + size_in * size_out, start + (size_in + 1) * size_out
        slices.append((slice(start, middle), slice(middle, end), (size_out, size_in)))
        start = end
    return slices


@dataclass(frozen=True)
class AdjointTapes:
    """CasADi functions of the derivatives of one step of a rollout, with arguments as in :class:`RolloutTapes`.

    - `step: (x, theta, w, p, lam, xbar) -> (xbar_before, thetabar)`
    - `score: (x, theta, w) -> thetabar`, the product D_theta law(x, theta)' w, without the components of w that
      do not affect the cost in state x, see `cost_dependence`
    - `terminal: (x, p) -> xbar`
    - `observe: (x, p, obar) -> xbar`, None without layers
    """

    step: ca.Function
    score: ca.Function
    terminal: ca.Function
    observe: ca.Function | None


@dataclass(frozen=True)
class RolloutTapes:
    """CasADi functions of one step of a rollout; all are SX, and their arguments are dense columns.

    Here x is the system's state followed by the `n_carried` variables that the objective adds to it;
    `nx` counts both.

    - `forward: (x, theta, w, p) -> (x_next, lam, cost)`, or an `InnerLoop` if lam has no closed form
    - `terminal: (x, p) -> cost`
    - `adjoint`, the derivatives, None for rollouts of which only costs and states are needed

    Where entry `end_entry` of x is zero the rollout has ended, and x does not change any more.

    With `layers`, the argument theta is the mean action, the output of the layers.

    In all graphs p is the output of `derived: parameters -> p`: the `np` subexpressions of the graphs that
    depend only on parameters.
    """

    nx: int
    n_carried: int
    nu: int
    np: int
    nlam: int
    n_theta: int
    forward: ca.Function | InnerLoop | ModelStepGraphs
    terminal: ca.Function
    derived: ca.Function
    adjoint: AdjointTapes | None = None
    layers: Layers | None = None
    end_entry: int | None = None

    def with_starts(self, starts: int) -> RolloutTapes:
        """Return these graphs with at most ``starts`` other starts for a step whose path fails."""
        if not isinstance(self.forward, InnerLoop):
            return self
        return replace(self, forward=replace(self.forward, starts=min(starts, self.forward.starts)))


@dataclass(frozen=True)
class ModelStepGraphs:
    """Graphs of a step with a learned model, which is evaluated between the two graphs.

    - `queries: (x, theta, w, p) -> z`, the model's inputs, branch after branch
    - `closing: (x, theta, w, p, lam) -> (x_next, lam, cost)`

    Here lam is `LearnedStep.model_outputs`: the model's outputs, and its Jacobians, which the adjoint
    needs.
    """

    with_p: ClassVar[tuple[str, ...]] = ("queries", "closing")

    queries: ca.Function
    closing: ca.Function
    model: LearnedMap
