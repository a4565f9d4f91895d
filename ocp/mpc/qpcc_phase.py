"""Real-time iteration with complementarity constraints and exchanges of the active set."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from ocp.mpc.active_set import ActiveSets
from ocp.mpc.horizon_qp import Direction
from ocp.mpc.linearised import Affine, LinearClosure, Linearised
from ocp.mpc.newton_phase import NewtonPhase, PairExchange, Prepared
from ocp.mpc.rollouts import CandidateRollouts
from ocp.mpc.stages import Plan, StageModel, StageValues

ACTIVE_TOLERANCE = 1e-6
"""Value of an inequality row, in characteristic sizes, up to which it counts as active."""
MIN_EXCHANGE_GAIN = 1e-4
"""Minimum gain for which a pair is exchanged, in characteristic costs per characteristic size."""


class QPCC(NewtonPhase):
    """Phase that solves a quadratic program with complementarity constraints by exchanges of the active set.

    In each program one side (force or gap) of each pair is fixed at zero, and the other is constrained to 0 or
    above. At the program's solution, a pair with both sides at zero may be exchanged, that is, its other side
    is fixed. This lowers the cost if the derivative of the program's optimum with respect to the fixed side,

        sigma_i = -y_k' (d x_{k+1} / d eps_i) - sum_j z_kj (d row_kj / d eps_i),

    is negative. All pairs with ``sigma_i < 0`` are exchanged at once, in the program of the next sample (or
    iteration): that program is linearised at the new plan in any case, so that an exchange needs no program of
    its own. If no such pair is left and multipliers are unique, the program's solution is strongly stationary.
    """

    exchanges = True
    product = False
    constants: ClassVar[dict[str, float]] = {
        "EXCHANGES": 1,
        "ACTIVE_TOLERANCE": ACTIVE_TOLERANCE,
        "MIN_EXCHANGE_GAIN": MIN_EXCHANGE_GAIN,
    }

    def __init__(
        self, model: StageModel, rollouts: CandidateRollouts, iterations: int = 1, budget: int | None = None
    ) -> None:
        super().__init__(model, rollouts, iterations, budget)
        self.sets = ActiveSets(model)

    def active_set(self, plan: Plan) -> tuple[np.ndarray, bool]:
        """Return the active set (n, pairs) of a plan with the exchange that the last program chose, if it has one.

        A plan that is tracked may have become shorter. A pair on whose side the plan and the last program differ is
        not exchanged.
        """
        closed = self.sets.of(plan)
        if self.exchange is None:
            return closed, False
        closed_before, pairs = (v[: len(closed)] for v in self.exchange)
        changed = pairs & (closed == closed_before)
        return (self.sets.exchange(closed, changed), True) if changed.any() else (closed, False)

    @property
    def n_rows(self) -> int:
        """Number of rows per step: one row for each pair and for each constraint."""
        return self.model.n + self.model.m

    def closure(self, plan: Plan, evaluated: StageValues, closed: np.ndarray) -> LinearClosure:
        """Return the closure that fixes one side of each pair at zero."""
        return LinearClosure.from_active_set(plan, closed)

    def rows(self, lin: Linearised, closed: np.ndarray) -> Affine:
        """Return the rows: forces of closed pairs and gaps of open pairs, then the constraints."""
        lam_size, gap_size = self.model.sizes
        lam, gap = lin.lam, lin.gap
        value = np.where(closed, lam.value, gap.value)
        by_x = np.where(closed[:, :, None], lam.by_x, gap.by_x)
        by_u = np.where(closed[:, :, None], lam.by_u, gap.by_u)
        sizes = np.where(closed, lam_size, gap_size)
        free = self.sets.frictionless(closed)
        value, by_x[free], by_u[free] = np.where(free, sizes, value), 0.0, 0.0
        scaled = value / sizes, by_x / sizes[:, :, None], by_u / sizes[:, :, None]
        stacked_blocks = zip(scaled, lin.rows, strict=True)
        return Affine(*(np.concatenate(parts, axis=1) for parts in stacked_blocks))

    def choose_exchange(self, prepared: Prepared, step: Direction) -> None:
        """Choose the pairs with a gain, whose sides the next program exchanges."""
        pays = self._gains(prepared, step) > MIN_EXCHANGE_GAIN
        if self.exchanges and pays.any():
            self.exchange = PairExchange(prepared.closed, pays)

    @property
    def cost(self) -> float:
        """Characteristic cost of the problem."""
        return self.model.problem.scales.cost

    def _gains(self, prepared: Prepared, direction: Direction) -> np.ndarray:
        """Return -sigma (N, n) in characteristic costs per size, 0 for pairs that may not be exchanged."""
        closed, lin, rows = prepared.closed, prepared.lin, prepared.rows
        model = self.model
        n, nx, sizes = model.n, model.nx, model.sizes
        row_values = rows.value[:, :n] + np.einsum("kij,kj->ki", rows.by_x[:, :n], direction.dx[:-1])
        row_values += np.einsum("kij,kj->ki", rows.by_u[:, :n], direction.du)
        touching = (row_values <= max(ACTIVE_TOLERANCE, direction.tolerance.residual)) & self.sets.exchangeable(closed)
        if not touching.any():
            return np.zeros_like(row_values)
        held_sizes, free_sizes = np.where(closed, *sizes), np.where(closed, *sizes[::-1])
        by_rows = np.where(closed[:, :, None], lin.by_closure[:, nx:], lin.gap_by_closure)
        sigma = -np.einsum("ki,kij->kj", direction.costates, lin.by_closure[:, :nx])
        sigma -= np.einsum("ki,kij->kj", direction.rows[:, :n], by_rows / held_sizes[:, :, None])
        sigma -= np.einsum("ki,kij->kj", direction.rows[:, n:], lin.rows_by_closure)
        gains = -sigma * free_sizes
        gains[~touching] = 0.0
        return gains / self.cost


class FixedActiveSet(QPCC):
    """Phase that solves the program of :class:`QPCC` without exchanges, with the active set of the last plan."""

    exchanges = False
    constants: ClassVar[dict[str, float]] = {**QPCC.constants, "EXCHANGES": 0}
