"""Gains of the linear-quadratic regulator along a plan."""

from __future__ import annotations

from functools import cached_property

import casadi as ca
import numpy as np

from dynamics.batch.engines.c_horizon import horizon_algebra
from dynamics.systems.elimination import solve_without_pivoting
from ocp.mpc.linearised import Linearised
from ocp.mpc.tracking import pad_horizon

INPUT_CURVATURE_SHARE = 1e-9
"""Multiple of the identity added to Quu, relative to the mean of Quu's diagonal."""


class Regulator:
    """Linear-quadratic regulator along a plan, by the Riccati recursion backwards in time.

    ``K_k = -Quu^-1 Qux``, ``Q = H_k + (A_k B_k)' V_{k+1} (A_k B_k)`` and ``V_k = Qxx + Qxu K_k``. The previous
    input is treated as constant, so the effect of an input on the cost of the next change of inputs is
    neglected. Without a C compiler CasADi repeats one step N times.
    """

    def __init__(self, nx: int, nu: int, N: int) -> None:
        self.nx, self.nu, self.N = nx, nu, N
        self._algebra = horizon_algebra()

    @cached_property
    def _backwards(self) -> ca.Function:
        nx, nu = self.nx, self.nu
        V, AB = ca.SX.sym("V", nx, nx), ca.SX.sym("AB", nx, nx + nu)
        H = ca.SX.sym("H", nx + nu, nx + nu)
        Q = H + AB.T @ V @ AB
        Quu = Q[nx:, nx:]
        Quu = Quu + INPUT_CURVATURE_SHARE / nu * ca.trace(Quu) * ca.SX.eye(nu)
        K = -solve_without_pivoting(Quu, Q[nx:, :nx])
        value_hessian = Q[:nx, :nx] + Q[:nx, nx:] @ K
        step = ca.Function("mpc_riccati", [V, AB, H], [0.5 * (value_hessian + value_hessian.T), K], {"cse": True})
        return step.mapaccum(self.N)

    def gains(self, lin: Linearised) -> np.ndarray:
        """Return the gains K (n, nu, nx) of a horizon of n <= N steps, all zero if any entry is not finite."""
        nx, nu, N, n = self.nx, self.nu, self.N, len(lin.gradient)
        if self._algebra is not None:
            share = INPUT_CURVATURE_SHARE / nu
            gains = self._algebra.riccati(lin.x_next.by_x, lin.x_next.by_u, lin.hessian, lin.end[1], share)
        else:
            lin = pad_horizon(lin, N)
            AB = np.concatenate([lin.x_next.by_x, lin.x_next.by_u], axis=2)
            xu = np.r_[:nx, nx + nu : nx + 2 * nu]
            columns = (
                v[::-1].transpose(1, 0, 2).reshape(v.shape[1], -1) for v in (AB, lin.hessian[:, xu[:, None], xu])
            )
            _, K = self._backwards(lin.end[1], *columns)
            gains = np.asarray(K).reshape(nu, N, nx).transpose(1, 0, 2)[::-1][:n]
        return gains if np.isfinite(gains).all() else np.zeros_like(gains)
