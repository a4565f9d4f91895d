"""How a rollout chooses its inputs: a function of state and parameters, applied at every step."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca


@dataclass(frozen=True)
class RolloutPolicy:
    """u_t = law(x_t, theta) + w_t, theta the parameters that gradients are taken by.

    `law` is a CasADi function `(x, theta) -> u`. With `per_step` every step has parameters of its
    own, so that theta is `(horizon, n_theta)`; without, one `(n_theta,)` serves all steps.
    """

    law: ca.Function
    per_step: bool

    def __post_init__(self) -> None:
        if self.law.n_in() != 2 or self.law.n_out() != 1:
            raise ValueError(
                f"a policy is a function (x, theta) -> u, but '{self.law.name()}' has "
                f"{self.law.n_in()} inputs and {self.law.n_out()} outputs"
            )

    @property
    def n_theta(self) -> int:
        """Parameters of one step."""
        return self.law.nnz_in(1)

    def total(self, horizon: int) -> int:
        """Parameters of a whole rollout."""
        return self.n_theta * (horizon if self.per_step else 1)

    def shape(self, horizon: int) -> tuple[int, ...]:
        """Shape of theta for one sample."""
        return (horizon, self.n_theta) if self.per_step else (self.n_theta,)


def open_loop(nx: int, nu: int) -> RolloutPolicy:
    """u_t = theta_t: the inputs themselves, theta (horizon, nu)."""
    x, theta = ca.SX.sym("x", nx), ca.SX.sym("theta", nu)
    return RolloutPolicy(ca.Function("open_loop", [x, theta], [theta]), per_step=True)


def affine(nx: int, nu: int, per_step: bool = False) -> RolloutPolicy:
    """u_t = K x_t + k, with theta the rows of K (nu, nx) one after the other, and then k (nu)."""
    x, theta = ca.SX.sym("x", nx), ca.SX.sym("theta", nu * nx + nu)
    gain = ca.reshape(theta[: nu * nx], nx, nu).T
    law = ca.Function("affine", [x, theta], [gain @ x + theta[nu * nx :]])
    return RolloutPolicy(law, per_step)
