"""Real-time iteration with complementarity: the active set is exchanged by multipliers."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ocp.mpc.active_set import ActiveSets
from ocp.mpc.horizon_qp import Direction
from ocp.mpc.linearised import Affine, Closure, Linearised
from ocp.mpc.newton_phase import UNSOLVED, NewtonPhase, Prepared, Proposal
from ocp.mpc.phase import Sample
from ocp.mpc.rollouts import Roller
from ocp.mpc.stages import Evaluated, Plan, StageModel

_ACTIVE = 1e-6
"""A row counts as active below this, in characteristic sizes."""
_GAIN = 1e-4
"""An exchange must gain this much, in characteristic costs for a characteristic size."""


class _Tried(NamedTuple):
    """An active set, the horizon linearised with it, and the solution of its program."""

    closed: np.ndarray
    lin: Linearised
    rows: Affine
    found: Direction


class QPCC(NewtonPhase):
    """Quadratic program with complementarity constraints, solved by exchanges of its active set.

    Each pair holds one side at zero and the other at or above. At the solution of that program a
    pair with both sides at zero may change its side: the derivative of the program's optimum by the
    side that was held,

        sigma_i = -y_k' (d x_{k+1} / d eps_i) - sum_j z_kj (d row_kj / d eps_i),

    says whether it pays. Pairs with ``sigma_i < 0`` are exchanged, all at once or, where the
    optimum does not fall, the best alone, at most ``exchanges`` times. With none left
    the program's solution is strongly stationary where its multipliers are unique.
    """

    exchanges = 2

    def __init__(self, model: StageModel, roller: Roller, iterations: int = 1) -> None:
        super().__init__(model, roller, iterations)
        self.sets = ActiveSets(model)

    def active(self, plan: Plan) -> np.ndarray:
        """The active set of a plan."""
        return self.sets.of(plan)

    @property
    def n_rows(self) -> int:
        """Every pair and every constraint."""
        return self.model.n + self.model.m

    def closure(self, plan: Plan, at: Evaluated, closed: np.ndarray) -> Closure:
        """The active set."""
        return Closure.active(plan, closed)

    def rows(self, lin: Linearised, closed: np.ndarray) -> Affine:
        """Forces of closed pairs, gaps of open ones, then the constraints."""
        lam_size, gap_size = self.model.sizes
        lam, gap = lin.lam, lin.gap
        value = np.where(closed, lam.value, gap.value)
        by_x = np.where(closed[:, :, None], lam.by_x, gap.by_x)
        by_u = np.where(closed[:, :, None], lam.by_u, gap.by_u)
        sizes = np.where(closed, lam_size, gap_size)
        free = self.sets.frictionless(closed)
        value, by_x[free], by_u[free] = np.where(free, sizes, value), 0.0, 0.0
        scaled = value / sizes, by_x / sizes[:, :, None], by_u / sizes[:, :, None]
        both = zip(scaled, lin.rows, strict=True)
        return Affine(*(np.concatenate(parts, axis=1) for parts in both))

    def proposals(self, prepared: Prepared, sample: Sample) -> tuple[list[Proposal], str]:
        """The step with the plan's active set, and the best after exchanges."""
        first = best = self._tried(prepared.lin, prepared.closed, sample)
        if not first.found.solved:
            return [], UNSOLVED
        exchanges = 0
        for _ in range(self.exchanges):
            better = self._exchanged(prepared, best, sample)
            if better is None:
                break
            best, exchanges = better, exchanges + 1
        steps = [Proposal(first.found, first.lin)]
        if not exchanges:
            return steps, ""
        return [*steps, Proposal(best.found, best.lin)], "contacts were exchanged"

    def _exchanged(self, prepared: Prepared, best: _Tried, sample: Sample) -> _Tried | None:
        """The program after an exchange that lowers its optimum, None where there is none."""
        gains = self._gains(best)
        wanted = gains > _GAIN
        if not wanted.any():
            return None
        alone = gains == gains.max()
        for which in (wanted, alone)[: 1 + (wanted.sum() > 1)]:
            closed = self.sets.exchanged(best.closed, which)
            lin = self.linearised(prepared.plan, prepared.at, closed)
            tried = self._tried(lin, closed, sample)
            fallen = tried.found.objective < best.found.objective - _GAIN * self.cost
            if tried.found.solved and fallen:
                return tried
        return None

    @property
    def cost(self) -> float:
        """The characteristic cost."""
        return self.model.problem.scales.cost

    def _tried(self, lin: Linearised, closed: np.ndarray, sample: Sample) -> _Tried:
        rows = self.rows(lin, closed)
        return _Tried(closed, lin, rows, self.solve(lin, rows, sample))

    def _gains(self, tried: _Tried) -> np.ndarray:
        """Minus sigma (N, n) of pairs with both sides at zero, in characteristic costs."""
        closed, lin, rows, found = tried
        model = self.model
        n, nx, sizes = model.n, model.nx, model.sizes
        at = rows.value[:, :n] + np.einsum("kij,kj->ki", rows.by_x[:, :n], found.dx[:-1])
        at += np.einsum("kij,kj->ki", rows.by_u[:, :n], found.du)
        touching = (at <= _ACTIVE) & self.sets.exchangeable(closed)
        if not touching.any():
            return np.zeros_like(at)
        own, held = np.where(closed, *sizes), np.where(closed, *sizes[::-1])
        by_rows = np.where(closed[:, :, None], lin.by_closure[:, nx:], lin.gap_by_closure)
        sigma = -np.einsum("ki,kij->kj", found.costates, lin.by_closure[:, :nx])
        sigma -= np.einsum("ki,kij->kj", found.rows[:, :n], by_rows / own[:, :, None])
        sigma -= np.einsum("ki,kij->kj", found.rows[:, n:], lin.rows_by_closure)
        gains = -sigma * held
        gains[~touching] = 0.0
        return gains / self.cost


class FixedActiveSet(QPCC):
    """The program of :class:`QPCC` without exchanges: contacts stay as the plan has them."""

    exchanges = 0
