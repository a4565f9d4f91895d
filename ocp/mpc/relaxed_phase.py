"""Feedback phase of Newton steps under a smoothed contact law at fixed mu."""

from __future__ import annotations

import numpy as np

from ocp.mpc.linearised import Affine, LinearClosure, Linearised
from ocp.mpc.newton_phase import NewtonPhase
from ocp.mpc.stages import Plan, StageValues


class Relaxed(NewtonPhase):
    """Phase of Newton steps on the smoothed problem, with ``lam gap = mu`` linearised at the plan."""

    @property
    def n_rows(self) -> int:
        """Number of rows per step: the constraints only, since the law keeps forces and gaps positive."""
        return self.model.m

    def closure(self, plan: Plan, evaluated: StageValues, closed: np.ndarray) -> LinearClosure:
        """Return the closure ``lam gap = mu``, linearised at the plan."""
        return LinearClosure.from_product(plan, evaluated.mu, self.model.sizes)

    def rows(self, lin: Linearised, closed: np.ndarray) -> Affine:
        """Return the rows of path constraints and bounds, which must be 0 or above."""
        return lin.rows
