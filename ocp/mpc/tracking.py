"""Tracking of a stored plan: its trajectory as the first plan, and horizons shorter than their program."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Protocol

import numpy as np

from ocp.errors import InputError
from ocp.mpc.linearised import Affine, Linearised
from ocp.mpc.stages import Plan, StageModel

if TYPE_CHECKING:
    import xarray as xr


class TrackedPlan(Protocol):
    """Interface of a solution or a stored run, whose ``data`` are arrays x and u, and lam if known, of a plan."""

    @property
    def data(self) -> xr.Dataset:
        """Arrays x (S, N+1, nx), u (S, N, nu) and lam (S, N, n), of which scenario 0 is tracked."""
        ...


def read_plan(model: StageModel, stored: TrackedPlan) -> Plan:
    """Return scenario 0 of a stored plan; multipliers of another contact law are replaced by zeros.

    Raises :class:`~ocp.errors.InputError` for arrays that are absent, not finite, or of another size than the
    problem's.
    """
    data = getattr(stored, "data", {})
    if "x" not in data or "u" not in data:
        raise InputError("plan must be a solution or a stored run with states x and inputs u")
    x, u = (np.asarray(data[name].values[0], dtype=float) for name in ("x", "u"))
    N, nx, nu = model.N, model.nx, model.nu
    if x.shape != (N + 1, nx) or u.shape != (N, nu):
        raise InputError(
            f"the plan has {len(u)} steps of {x.shape[-1]} states and {u.shape[-1]} inputs, but"
            f" {model.problem.name} has {N} steps of {nx} and {nu}; build the problem with the plan's parameters"
        )
    lam = np.zeros((N, model.n))
    if "lam" in data and data["lam"].shape[1:] == lam.shape:
        lam = np.array(data["lam"].values[0])
    plan = Plan(x.copy(), u.copy(), lam, np.zeros_like(lam))
    if not (plan.finite and np.isfinite(lam).all()):
        raise InputError("the plan has values that are not finite; track a run that converged")
    return plan


def pad_steps(values: np.ndarray, N: int) -> np.ndarray:
    """Return an array (n, ...) extended to (N, ...) by zeros."""
    return np.concatenate([values, np.zeros((N - len(values), *values.shape[1:]))])


def pad_horizon(lin: Linearised, N: int) -> Linearised:
    """Return the model of a horizon of n steps as one of N steps with the same optimum, or unchanged if n = N.

    Steps n to N-1 keep the state, ``dx_{k+1} = dx_k``, and their cost is the square of du, so that du = 0. The
    terminal cost is part of the cost of step n, whose state is the last one of the horizon. Only arrays that the
    regulator reads are extended.
    """
    n, nx, nu = len(lin.gradient), *lin.x_next.by_u.shape[1:]
    if n == N:
        return lin
    x_next = Affine(*(pad_steps(block, N) for block in lin.x_next))
    gradient, hessian = (pad_steps(block, N) for block in (lin.gradient, lin.hessian))
    x_next.by_x[n:] = np.eye(nx)
    gradient[n, :nx], hessian[n, :nx, :nx] = lin.end
    inputs = np.arange(nx + nu, nx + 2 * nu)
    curvature = hessian[n - 1, inputs, inputs]
    hessian[n:, inputs, inputs] = np.where(curvature > 0, curvature, 1.0)
    end = np.zeros(nx), np.zeros((nx, nx))
    return replace(lin, x_next=x_next, gradient=gradient, hessian=hessian, end=end)
