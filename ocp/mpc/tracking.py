"""Tracking of a stored plan: its trajectory as the first plan."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import numpy as np

from ocp.errors import InputError
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
