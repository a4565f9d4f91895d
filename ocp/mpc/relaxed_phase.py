"""Newton steps on a smoothed law at the mu of the moment, as soft contact models are used."""

from __future__ import annotations

import numpy as np

from ocp.mpc.linearised import Affine, LinearClosure, Linearised
from ocp.mpc.newton_phase import NewtonPhase
from ocp.mpc.stages import Plan, StageValues


class Relaxed(NewtonPhase):
    """``lam gap = mu`` linearised at the plan: Gauss and Newton's step on the smoothed problem."""

    @property
    def n_rows(self) -> int:
        """Number of constraints; the law keeps forces and gaps positive."""
        return self.model.m

    def closure(self, plan: Plan, evaluated: StageValues, closed: np.ndarray) -> LinearClosure:
        """Return the law's closure, linearised."""
        return LinearClosure.from_product(plan, evaluated.mu, self.model.sizes)

    def rows(self, lin: Linearised, closed: np.ndarray) -> Affine:
        """Return the constraints."""
        return lin.rows
