"""The graphs of one step of a rollout, as engines take them, and which noise affects the cost.

Where noise does not affect the cost, the cost times the score `w_t / sigma^2` has mean zero and only
adds variance. Such noise is left out by the graphs alone, before it is drawn, so that no mean changes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar

import casadi as ca
import numpy as np

from dynamics.batch.graphs.inner import InnerLoop
from dynamics.contact.learned_step import LearnedMap


@dataclass(frozen=True)
class CostDependence:
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
        """Return masks of w_t (horizon, nu) and x_{t+1} (horizon, nx) that reach the cost of a rollout."""
        noise_reaches, state_reaches = [], [self.at_end]
        for _ in range(horizon):
            reaches_cost = np.append(state_reaches[-1], True)
            noise_reaches.append(reaches_cost @ self.by_w)
            state_reaches.append(reaches_cost @ self.by_x)
        return np.array(noise_reaches[::-1]), np.array(state_reaches[-2::-1])


def cost_dependence(outputs: ca.SX, terminal: ca.SX, x: ca.SX, w: ca.SX) -> CostDependence:
    """The ways of a step with `outputs` (x_next, cost) in (x, w), and `terminal` in x.

    Gates are looked for among states that no noise moves: others are zero by chance alone.
    """
    by_x, by_w = dependence_table(outputs, x), dependence_table(outputs, w)
    nx = x.numel()
    noise_ways = CostDependence(by_x, by_w, dependence_table(terminal, x)[0], np.zeros((w.numel(), nx), dtype=bool))
    noise_reaches, state_reaches = noise_ways.over(nx + 1)
    is_noiseless = ~by_w[:-1].any(axis=1)
    for _ in range(nx):
        is_noiseless &= ~by_x[:-1, ~is_noiseless].any(axis=1)
    needed_rows = np.append(state_reaches.any(axis=0), True)
    for s in np.flatnonzero(is_noiseless):
        outputs_at_zero = ca.substitute(outputs[np.flatnonzero(needed_rows).tolist()], x[int(s)], 0)
        noise_ways.gates[:, s] = noise_reaches.any(axis=0) & ~dependence_table(outputs_at_zero, w).any(axis=0)
    return noise_ways


def dependence_table(expression: ca.SX, symbols: ca.SX) -> np.ndarray:
    """Return a Boolean table: entries of an expression (rows) that depend on `symbols` (columns)."""
    pattern = ca.jacobian_sparsity(ca.densify(expression), symbols)
    return np.array(ca.DM(pattern, 1).full(), dtype=bool).reshape(expression.numel(), symbols.numel())


def stand_ins(unknown: ca.SX, rows: ca.SX) -> ca.SX:
    """Return, for each unknown, an expression with the same dependencies.

    Unknown i solves `rows` i (n, 1), together with those that these rows tie it to.
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
    """Dense layers of `sizes` between an observation and the mean action.

    - `observe: (x, p) -> o`, and `observe_adjoint: (x, p, obar) -> xbar`
    """

    sizes: tuple[int, ...]
    observe: ca.Function
    observe_adjoint: ca.Function

    @property
    def n_weights(self) -> int:
        """Weights and offsets of all layers."""
        return layer_slices(self.sizes)[-1][1].stop


def layer_slices(sizes: Sequence[int]) -> list[tuple[slice, slice, tuple[int, int]]]:
    """Entries of theta that are each layer's weights and offsets, and the weights' shape."""
    slices, start = [], 0
    for size_in, size_out in pairwise(sizes):
        middle, end = start + size_in * size_out, start + (size_in + 1) * size_out
        slices.append((slice(start, middle), slice(middle, end), (size_out, size_in)))
        start = end
    return slices


@dataclass(frozen=True)
class RolloutTapes:
    """CasADi functions of one step; all SX, all arguments dense columns.

    Here x is what goes from step to step: the system's state and what the objective carries beside
    it (`nx` counts both, `n_carried` the latter).

    - `forward: (x, theta, w, p) -> (x_next, lam, cost)`, or an `InnerLoop` where there is no
      closed form for lam
    - `adjoint: (x, theta, w, p, lam, xbar) -> (xbar_before, thetabar)`
    - `score: (x, theta, w) -> thetabar`, the product D_theta law(x, theta)' w, of what of w acts in
      state x; `ways` states which noise acts
    - `terminal: (x, p) -> cost` and `terminal_adjoint: (x, p) -> xbar`

    A sample whose entry `weight` of x is zero has come to its end: nothing of it changes any more.

    With `layers` theta is the mean action, which those compute.

    In all of these p stands for the `np` values `derived: parameters -> p`, which hold whatever
    the graphs need that depends on parameters alone.
    """

    nx: int
    n_carried: int
    nu: int
    np: int
    nlam: int
    n_theta: int
    forward: ca.Function | InnerLoop | ModelStepGraphs
    adjoint: ca.Function
    score: ca.Function
    cost_dependence: CostDependence
    terminal: ca.Function
    terminal_adjoint: ca.Function
    derived: ca.Function
    layers: Layers | None = None
    weight: int | None = None


@dataclass(frozen=True)
class ModelStepGraphs:
    """A step whose next state comes from a model of it, evaluated beside the graphs.

    - `queries: (x, theta, w, p) -> z`, where the model is evaluated, branch after branch
    - `closing: (x, theta, w, p, lam) -> (x_next, lam, cost)`

    In place of lam there is `LearnedStep.evaluated`: the model's outputs, and its Jacobians, which
    the adjoint needs.
    """

    with_p: ClassVar[tuple[str, ...]] = ("queries", "closing")

    queries: ca.Function
    closing: ca.Function
    model: LearnedMap
