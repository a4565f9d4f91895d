"""Policies of rollouts: functions from state and parameters to the input, applied at every step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from dynamics.batch.graphs.objective import expand_function
from dynamics.batch.graphs.step_graphs import dependence_table, layer_slices
from dynamics.systems import ParameterTable
from dynamics.systems.parameters import matrix_parameters


@dataclass(frozen=True)
class RolloutPolicy:
    """Policy u_t = actuate(law(x_t, theta) + w_t), with parameters theta for which gradients are computed.

    `law` is a CasADi function `(x, theta) -> a`, `actuate` is `a -> u`, or None for the identity. With
    `per_step` each step has its own parameters, and theta is `(horizon, n_theta)`; otherwise all steps share
    the parameters `(n_theta,)`.
    """

    law: ca.Function
    per_step: bool
    actuate: ca.Function | None = None

    def __post_init__(self) -> None:
        if self.law.n_in() != 2 or self.law.n_out() != 1:
            raise ValueError(
                f"a policy is a function (x, theta) -> u, but '{self.law.name()}' has "
                f"{self.law.n_in()} inputs and {self.law.n_out()} outputs"
            )

    @property
    def n_theta(self) -> int:
        """Number of parameters of one step."""
        return self.law.nnz_in(1)

    @cached_property
    def parameters(self) -> ParameterTable:
        """Parameters that the policy adds to the p of the step, without gradients; by default an empty table."""
        return ParameterTable()

    def total(self, horizon: int) -> int:
        """Number of parameters of the policy over a whole rollout."""
        return self.n_theta * (horizon if self.per_step else 1)

    def acting_parameters(self, noise: np.ndarray) -> np.ndarray:
        """Return a mask, of theta's shape, of parameters that affect an action marked in `noise` (horizon, n_a)."""
        x, theta = (ca.SX.sym("a", self.law.numel_in(k)) for k in range(2))
        reaches = noise @ dependence_table(expand_function(self.law)(x, theta), theta)
        return reaches if self.per_step else np.any(reaches, axis=0, keepdims=True)[0]

    def shape(self, horizon: int) -> tuple[int, ...]:
        """Shape of theta for one sample."""
        return (horizon, self.n_theta) if self.per_step else (self.n_theta,)


@dataclass(frozen=True, kw_only=True)
class DensePolicy(RolloutPolicy):
    """Policy given by a network of dense layers with tanh between them, on normalised observations.

        o = (observe(x, p) - mean) / scale
        a = W_L tanh(... tanh(W_1 o + b_1) ...) + b_L + w,    u = actuate(a)

    `sizes` are the lengths of o, of the hidden layers and of a; theta holds W_1 row by row, b_1, W_2, and so
    on. `law` takes the mean action in place of theta. The mean action is computed in loops over the layers, so that
    no graph grows with the sizes. Raises `ValueError` for sizes that are not positive integers.
    """

    observe: ca.Function
    sizes: tuple[int, ...]

    def __post_init__(self) -> None:
        super().__post_init__()
        if any(isinstance(n, bool) or n != int(n) or n < 1 for n in self.sizes):
            raise ValueError(f"layers must have whole sizes of at least 1, got {self.sizes}")

    @property
    def n_theta(self) -> int:
        """Number of weights and offsets of all layers."""
        return layer_slices(self.sizes)[-1][1].stop

    def acting_parameters(self, noise: np.ndarray) -> np.ndarray:
        """Return a mask (n_theta,), false for the last layer's entries of actions that `noise` never marks."""
        reaches = np.full(self.n_theta, noise.any())
        weights, offsets = self.layers(reaches)[-1]
        offsets[:] = noise.any(axis=0)
        weights[:] = offsets[:, None]
        return reaches

    @cached_property
    def parameters(self) -> ParameterTable:
        """Parameters `mean[i]` and `scale[i]` that normalise the observations."""
        n = self.sizes[0]
        return ParameterTable([*matrix_parameters("mean", np.zeros(n)), *matrix_parameters("scale", np.ones(n))])

    def layers(self, theta: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return W (n_out, n_in) and b (n_out,) of every layer as views of theta (..., n_theta)."""
        return [
            (theta[..., weights].reshape(*theta.shape[:-1], *shape), theta[..., offsets])
            for weights, offsets, shape in layer_slices(self.sizes)
        ]

    def mean_actions(self, theta: np.ndarray, observations: np.ndarray) -> np.ndarray:
        """Return the mean actions a (n, n_a) at normalised observations (n, n_o), for one theta (n_theta,)."""
        *hidden, (W, b) = self.layers(theta)
        values = observations
        for weights, offsets in hidden:
            values = np.tanh(values @ weights.T + offsets)
        return values @ W.T + b


def open_loop(nx: int, nu: int) -> RolloutPolicy:
    """Return the open-loop policy u_t = theta_t, with the inputs as parameters, theta (horizon, nu)."""
    return RolloutPolicy(_identity_law(nx, nu, "open_loop"), per_step=True)


def affine_policy(nx: int, nu: int, per_step: bool = False) -> RolloutPolicy:
    """Return the policy u_t = K x_t + k, with theta the rows of K (nu, nx), followed by k (nu,)."""
    x, theta = ca.SX.sym("x", nx), ca.SX.sym("theta", nu * nx + nu)
    gain = ca.reshape(theta[: nu * nx], nx, nu).T
    law = ca.Function("affine", [x, theta], [gain @ x + theta[nu * nx :]])
    return RolloutPolicy(law, per_step)


def constant_policy(nx: int, lower: Any, upper: Any) -> RolloutPolicy:
    """Return the policy with the same input at every step, u = squash(theta + w), see `squash_function`."""
    squash = squash_function(lower, upper)
    law = _identity_law(nx, squash.numel_in(0), "constant")
    return RolloutPolicy(law, per_step=False, actuate=squash)


def dense_policy(observe: ca.Function, hidden: Sequence[int], lower: Any, upper: Any) -> DensePolicy:
    """Return a network with hidden layers of these sizes and u = squash(a); without hidden layers, a is affine in o.

    `observe: (x, p) -> o` takes p as the functions of `Episode` do; for `squash` see `squash_function`.
    """
    squash = squash_function(lower, upper)
    return DensePolicy(
        law=_identity_law(observe.numel_in(0), squash.numel_in(0), "action"),
        per_step=False,
        actuate=squash,
        observe=observe,
        sizes=(observe.numel_out(0), *hidden, squash.numel_in(0)),
    )


def squash_function(lower: Any, upper: Any) -> ca.Function:
    """Return the function `a -> (lower + upper) / 2 + (upper - lower) / 2 tanh(a)` from actions to bounded inputs."""
    low, high = (np.atleast_1d(np.asarray(end, dtype=float)) for end in (lower, upper))
    if not (np.isfinite(low).all() and np.isfinite(high).all() and (low < high).all()):
        raise ValueError(f"inputs need finite bounds, lower below upper, got {low} and {high}")
    a = ca.SX.sym("a", len(low))
    return ca.Function("actuate", [a], [ca.DM(low + high) / 2 + ca.DM(high - low) / 2 * ca.tanh(a)])


def _identity_law(nx: int, n: int, name: str) -> ca.Function:
    """Return the law (x, theta) -> theta."""
    x, theta = ca.SX.sym("x", nx), ca.SX.sym("theta", n)
    return ca.Function(name, [x, theta], [theta])
