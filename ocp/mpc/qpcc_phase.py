"""Real-time iteration with complementarity constraints and exchanges of the active set."""

from __future__ import annotations

import numpy as np

from ocp.mpc.active_set import ActiveSets
from ocp.mpc.linearised import Affine, LinearClosure, Linearised
from ocp.mpc.newton_phase import NewtonPhase, Prepared, Proposal
from ocp.mpc.phase import Sample
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

    is negative. All pairs with ``sigma_i < 0`` are exchanged at once, and the exchange is kept if it lowers the
    optimum. It takes one more program; further exchanges are left to the next sample. If no such pair is left and
    multipliers are unique, the program's solution is strongly stationary.
    """

    exchanges = True

    def __init__(self, model: StageModel, rollouts: CandidateRollouts, iterations: int = 1) -> None:
        super().__init__(model, rollouts, iterations)
        self.sets = ActiveSets(model)

    def active_set(self, plan: Plan) -> np.ndarray:
        """Return the active set (N, n) of a plan."""
        return self.sets.of(plan)

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

    def proposals(self, prepared: Prepared, sample: Sample) -> tuple[list[Proposal], str]:
        """Return the proposal for the plan's active set, the best proposal after exchanges, and a note."""
        steps, note = super().proposals(prepared, sample)
        better = self._exchange_pairs(prepared, steps[-1], sample) if steps and self.exchanges else None
        return (steps, note) if better is None else ([steps[0], better], "contacts were exchanged")

    def _exchange_pairs(self, prepared: Prepared, incumbent: Proposal, sample: Sample) -> Proposal | None:
        """Return a proposal with exchanged pairs that lowers the program's optimum, or None."""
        pays = self._gains(incumbent) > MIN_EXCHANGE_GAIN
        if not pays.any():
            return None
        closed = self.sets.exchange(incumbent.closed, pays)
        trial = self.propose(self.linearise_plan(prepared.plan, prepared.evaluated, closed), closed, sample)
        improves = trial.step.objective < incumbent.step.objective - MIN_EXCHANGE_GAIN * self.cost
        return trial if trial.step.solved and improves else None

    @property
    def cost(self) -> float:
        """Characteristic cost of the problem."""
        return self.model.problem.scales.cost

    def _gains(self, tried: Proposal) -> np.ndarray:
        """Return -sigma (N, n) in characteristic costs per size, 0 for pairs that may not be exchanged."""
        closed, lin, rows, direction = tried
        model = self.model
        n, nx, sizes = model.n, model.nx, model.sizes
        row_values = rows.value[:, :n] + np.einsum("kij,kj->ki", rows.by_x[:, :n], direction.dx[:-1])
        row_values += np.einsum("kij,kj->ki", rows.by_u[:, :n], direction.du)
        touching = (row_values <= ACTIVE_TOLERANCE) & self.sets.exchangeable(closed)
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
