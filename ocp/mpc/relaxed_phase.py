"""Newton steps on a smoothed law at the mu of the moment, as soft contact models are used."""

from __future__ import annotations

import numpy as np

from ocp.mpc.linearised import Affine, Closure, Linearised
from ocp.mpc.newton_phase import UNSOLVED, NewtonPhase, Prepared, Proposal
from ocp.mpc.phase import Sample
from ocp.mpc.stages import Evaluated, Plan


class Relaxed(NewtonPhase):
    """``lam gap = mu`` linearised at the plan: Gauss and Newton's step on the smoothed problem."""

    @property
    def n_rows(self) -> int:
        """The constraints alone: the law keeps forces and gaps positive."""
        return self.model.m

    def closure(self, plan: Plan, at: Evaluated, closed: np.ndarray) -> Closure:
        """The law's own."""
        return Closure.product(plan, at.mu, self.model.sizes)

    def rows(self, lin: Linearised, closed: np.ndarray) -> Affine:
        """The constraints."""
        return lin.rows

    def proposals(self, prepared: Prepared, sample: Sample) -> tuple[list[Proposal], str]:
        """The step of the one program."""
        found = self.solve(prepared.lin, prepared.lin.rows, sample)
        return ([Proposal(found, prepared.lin)], "") if found.solved else ([], UNSOLVED)
