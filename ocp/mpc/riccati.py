"""Gains of the linear-quadratic regulator along a plan."""

from __future__ import annotations

import numpy as np

from ocp.mpc.linearised import Linearised

INPUT_CURVATURE_SHARE = 1e-9
"""Multiple of the identity added to Quu, relative to the mean of Quu's diagonal."""


def regulator_gains(lin: Linearised) -> np.ndarray:
    """Return gains K (n, nu, nx) of the regulator along a plan of n steps, all zero if any entry is not finite.

    The Riccati recursion backwards in time is ``K_k = -Quu^-1 Qux``, ``Q = H_k + (A_k B_k)' V_{k+1} (A_k B_k)`` and
    ``V_k = Qxx + Qxu K_k``. The previous input is treated as constant, so the effect of an input on the cost of the
    next change of inputs is neglected.
    """
    n, nx, nu = lin.x_next.by_u.shape
    xu, V = np.r_[:nx, nx + nu : nx + 2 * nu], lin.end[1]
    AB, H = np.concatenate([lin.x_next.by_x, lin.x_next.by_u], axis=2), lin.hessian[:, xu[:, None], xu]
    gains = np.zeros((n, nu, nx))
    for k in reversed(range(n)):
        Q = H[k] + AB[k].T @ V @ AB[k]
        curvature = Q[nx:, nx:] + INPUT_CURVATURE_SHARE / nu * np.trace(Q[nx:, nx:]) * np.eye(nu)
        try:
            gains[k] = -np.linalg.solve(curvature, Q[nx:, :nx])
        except np.linalg.LinAlgError:
            return np.zeros_like(gains)
        V = Q[:nx, :nx] + Q[:nx, nx:] @ gains[k]
        V = 0.5 * (V + V.T)
    return gains if np.isfinite(gains).all() else np.zeros_like(gains)
