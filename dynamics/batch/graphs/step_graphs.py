"""The graphs of one step of a rollout, as engines take them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar

import casadi as ca

from dynamics.batch.graphs.acting import Ways
from dynamics.batch.graphs.inner import InnerLoop
from dynamics.contact.casadi_map import LearnedMap


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
    """Of each layer: entries of theta that are weights, and offsets; the weights' shape."""
    found, at = [], 0
    for before, after in pairwise(sizes):
        middle, end = at + before * after, at + (before + 1) * after
        found.append((slice(at, middle), slice(middle, end), (after, before)))
        at = end
    return found


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
    forward: ca.Function | InnerLoop | Asked
    adjoint: ca.Function
    score: ca.Function
    ways: Ways
    terminal: ca.Function
    terminal_adjoint: ca.Function
    derived: ca.Function
    layers: Layers | None = None
    weight: int | None = None


@dataclass(frozen=True)
class Asked:
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
