"""Quadratic program of a horizon, solved by PIQP, which exploits the block structure over stages."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import piqp
import scipy.sparse as sp

from ocp.mpc.constraint_rows import PENALTIES
from ocp.mpc.linearised import Affine, Linearised
from ocp.mpc.stages import StageModel
from ocp.mpc.tracking import pad_horizon, pad_rows

PENALTY_CURVATURE = 1e-2
"""Second derivative of the penalty of a slack, relative to the penalty's slope."""
MAX_ROW_VALUE = 1e4
"""Value of a row, in characteristic sizes, above which the row is scaled down."""
QP_TOLERANCE = 1e-6
"""Smallest tolerance of a program's residuals, in characteristic sizes."""
RESIDUAL_SHARE = 1e-2
"""Tolerance of a program's residuals relative to the linearisation error."""
GAP_RATIO = 100.0
"""Tolerance of the duality gap in characteristic costs, relative to that of the residuals in sizes."""
MAX_LINEARISATION_ERROR = 0.1
"""Linearisation error, in characteristic sizes, above which tolerances grow no further."""
MAX_QP_ITERATIONS = 60
"""Maximum number of iterations of PIQP."""


class Tolerance(NamedTuple):
    """Absolute tolerances of a program: ``residual`` in characteristic sizes, duality ``gap`` in costs."""

    residual: float = QP_TOLERANCE
    gap: float = GAP_RATIO * QP_TOLERANCE

    @classmethod
    def of_error(cls, error: float) -> Tolerance:
        """Return tolerances that the next linearisation can notice, for the ``error`` of the last one.

        The error is the largest difference, in characteristic sizes, between the states that a program
        predicts and those of its rollout under the law, from which the next program is built. A program
        that is solved to a share of this error is an inexact Newton step with a forcing term by the
        disagreement of model and function (Eisenstat and Walker 1996, choice 1), so that the tolerance
        tightens as steps become small. The gap may equal the error, since the cost changes by one
        characteristic cost per characteristic size.
        """
        bounded = min(error, MAX_LINEARISATION_ERROR) if np.isfinite(error) else MAX_LINEARISATION_ERROR
        residual = max(QP_TOLERANCE, RESIDUAL_SHARE * bounded)
        return cls(residual, GAP_RATIO * residual)


TIGHT = Tolerance()
"""Tolerances of a program whose linearisation error is unknown."""


@dataclass(frozen=True)
class Direction:
    """Solution of a horizon's quadratic program: a step dx (N+1, nx), du (N, nu) of a plan, and multipliers.

    ``costates`` (N, nx) are the multipliers of the dynamics, and ``rows`` (N, n_rows) the multipliers of the
    inequality rows, in cost per characteristic size. ``objective`` is the predicted change of the cost plus the
    penalty of violated rows. ``violation`` is the sum of the slacks, in characteristic sizes. ``iterations`` is
    the number of iterations of the solver, which ended at ``tolerance``. ``usable`` is true for a solution,
    and for the last iterate of a solver that was stopped at its maximum number of iterations.
    """

    dx: np.ndarray
    du: np.ndarray
    costates: np.ndarray
    rows: np.ndarray
    objective: float
    violation: float
    solved: bool
    usable: bool
    iterations: int
    tolerance: Tolerance

    def first(self, n: int) -> Direction:
        """Return the solution of the first n steps."""
        return replace(self, dx=self.dx[: n + 1], du=self.du[:n], costates=self.costates[:n], rows=self.rows[:n])


class HorizonQP:
    """Quadratic program ``min sum_k 1/2 w' H w + g' w + penalty`` for a plan's step, of fixed sparsity.

    The variables of step k are du_k, slacks s_k and dx_{k+1}, and w_k = (dx_k, du_{k-1}, du_k). Dynamics and
    bounds on inputs are hard constraints. Inequality rows may be violated by s_k >= 0 at an exact penalty, so
    that every program is feasible. All rows of a step share one slack. If ``separate``, each of the model's
    constraints, which are the last rows, has its own slack, so that a constraint that cannot be satisfied does
    not relax the others.
    """

    def __init__(self, model: StageModel, rows: int, separate: bool = False) -> None:
        self.model, self.n_rows = model, rows
        nx, nu, N = model.nx, model.nu, model.N
        shared = rows - model.m if separate else rows
        self.slack_of = np.maximum(np.arange(rows) - shared + 1, 0)
        per_step = nu + (slacks := 1 + rows - shared) + nx
        self.size = N * per_step
        k = np.arange(N)[:, None] * per_step
        self.u, self.s = k + np.arange(nu), k + nu + np.arange(slacks)
        self.x_next = k + nu + slacks + np.arange(nx)
        self.x = np.concatenate([np.full((1, nx), -1), self.x_next[:-1]])
        inputs_before = np.concatenate([np.full((1, nu), -1), self.u[:-1]])
        if not model.problem.uses_du:
            inputs_before[:] = -1
        self.w = np.concatenate([self.x, inputs_before, self.u], axis=1)
        self._index_entries()
        self._solver: piqp.SparseSolver | None = None

    def _index_entries(self) -> None:
        """Fix the sparsity patterns of the Hessian, the equations and the rows."""
        N, nx, m = self.model.N, self.model.nx, self.n_rows
        nw, end = self.w.shape[1], self.x_next[-1]
        row, column = (np.broadcast_to(v, (N, nw, nw)) for v in (self.w[:, :, None], self.w[:, None]))
        self._P = _Pattern(
            np.concatenate([row.ravel(), np.repeat(end, nx), self.s.ravel()]),
            np.concatenate([column.ravel(), np.tile(end, nx), self.s.ravel()]),
            (self.size, self.size),
        )
        equation = np.arange(N * nx).reshape(N, nx)
        xu = np.concatenate([self.x, self.u], axis=1)
        self._A = _Pattern(
            np.concatenate([np.repeat(equation, xu.shape[1], axis=1).ravel(), equation.ravel()]),
            np.concatenate([np.tile(xu, (1, nx)).ravel(), self.x_next.ravel()]),
            (N * nx, self.size),
        )
        slack = self.s[:, self.slack_of, None]
        touched = np.concatenate([np.repeat(xu[:, None], m, axis=1), slack], axis=2)
        number = np.repeat(np.arange(N * m), touched.shape[2])
        self._G = _Pattern(number, touched.ravel(), (N * m, self.size))

    def solve(
        self,
        lin: Linearised,
        rows: Affine,
        dx0: np.ndarray,
        bounds: tuple[np.ndarray, np.ndarray],
        penalty: float = PENALTIES[0],
        accuracy: tuple[Tolerance, int] = (TIGHT, MAX_QP_ITERATIONS),
    ) -> Direction:
        """Return the step of a plan, given the measured state minus the plan's first state ``dx0`` (nx,).

        ``rows`` are constrained to 0 or above; ``bounds`` are the lower and upper bounds (N, nu) on du;
        ``penalty`` is the penalty of a slack, in characteristic costs per characteristic size; ``accuracy``
        has the tolerances, and the maximum number of iterations. The horizon may have n < N steps.
        """
        cost, N = self.model.problem.scales.cost, self.model.N
        if (n := len(rows.value)) < N:
            lower, upper = (np.pad(bound, ((0, N - n), (0, 0)), "edge") for bound in bounds)
            padded = pad_horizon(lin, N), pad_rows(rows, N)
            return self.solve(*padded, dx0, (lower, upper), penalty, accuracy).first(n)
        # The solver does not reach its tolerance if entries of 1e9 and of 1 occur together.
        least = rows.value.copy()
        least[0] += rows.by_x[0] @ dx0
        row_scales = np.maximum(1.0, least / MAX_ROW_VALUE)
        z, result = self._run_piqp(accuracy, *self._assemble(lin, rows, dx0, row_scales, penalty), *self._ends(*bounds))
        dx = np.concatenate([dx0[None], z[self.x_next]])
        is_solved, is_finite = result.info.status == piqp.PIQP_SOLVED, bool(np.isfinite(z).all())
        return Direction(
            dx,
            z[self.u],
            np.array(result.y).reshape(N, -1) * cost,
            np.array(result.z_l).reshape(N, self.n_rows) / row_scales * cost,
            float(result.info.primal_obj) * cost,
            float(z[self.s].sum()),
            is_solved and is_finite,
            is_finite and (is_solved or result.info.status == piqp.PIQP_MAX_ITER_REACHED),
            int(result.info.iter),
            accuracy[0],
        )

    def _ends(self, lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the bounds on all variables, from those (N, nu) on du."""
        x_l, x_u = np.full(self.size, -np.inf), np.full(self.size, np.inf)
        x_l[self.s] = 0.0
        x_l[self.u], x_u[self.u] = lower, upper
        return x_l, x_u

    def _assemble(
        self, lin: Linearised, rows: Affine, dx0: np.ndarray, row_scales: np.ndarray, penalty: float
    ) -> tuple[sp.csc_matrix, np.ndarray, sp.csc_matrix, np.ndarray, sp.csc_matrix, np.ndarray]:
        """Return P, c, A, b, G, h of ``min 1/2 z' P z + c' z`` subject to ``A z = b`` and ``G z >= h``."""
        N, nx, cost = self.model.N, self.model.nx, self.model.problem.scales.cost
        H, end = lin.hessian / cost, lin.end[1] / cost
        curvature = np.full(self.s.size, PENALTY_CURVATURE * penalty)
        P = self._P(np.concatenate([H.ravel(), end.ravel(), curvature]))
        dynamics = np.concatenate([lin.x_next.by_x, lin.x_next.by_u], axis=2)
        A = self._A(np.concatenate([-dynamics.ravel(), np.ones(N * nx)]))
        predicted, row_bounds = lin.x_next.value.copy(), -rows.value
        predicted[0] += lin.x_next.by_x[0] @ dx0
        row_bounds[0] -= rows.by_x[0] @ dx0
        entries = np.concatenate([rows.by_x, rows.by_u, np.ones((N, self.n_rows, 1))], axis=2)
        if (row_scales > 1.0).any():
            entries, row_bounds = entries / row_scales[:, :, None], row_bounds / row_scales
        c = self._gradient(lin, dx0, cost, penalty)
        return P, c, A, predicted.ravel(), self._G(entries.ravel()), row_bounds.ravel()

    def _gradient(self, lin: Linearised, dx0: np.ndarray, cost: float, penalty: float) -> np.ndarray:
        g = lin.gradient / cost
        g[0] += lin.hessian[0][:, : self.model.nx] @ dx0 / cost
        is_variable, c = self.w >= 0, np.zeros(self.size)
        np.add.at(c, self.w[is_variable], g[is_variable])
        c[self.x_next[-1]] += lin.end[0] / cost
        c[self.s] += penalty
        return c

    def _run_piqp(self, accuracy: tuple[Tolerance, int], *program: Any) -> tuple[np.ndarray, piqp.Result]:
        P, c, A, b, G, row_bounds, x_l, x_u = program
        solver = self._solver
        if solver is None:
            self._solver = solver = piqp.SparseSolver()
            solver.settings.kkt_solver = piqp.KKTSolver.sparse_multistage
            solver.settings.eps_rel = solver.settings.eps_duality_gap_rel = 0.0
            solver.setup(P, c, A, b, G, row_bounds, np.full(row_bounds.size, np.inf), x_l, x_u)
        else:
            solver.update(P, c, A, b, G, row_bounds, None, x_l, x_u)
        tolerance, solver.settings.max_iter = accuracy
        solver.settings.eps_abs, solver.settings.eps_duality_gap_abs = tolerance
        solver.solve()
        return np.array(solver.result.x), solver.result


class _Pattern:
    """Sparse matrix with a fixed pattern, filled from entries in a fixed order; the index -1 marks ignored entries."""

    def __init__(self, rows: np.ndarray, columns: np.ndarray, shape: tuple[int, int]) -> None:
        self.used = np.flatnonzero((rows >= 0) & (columns >= 0))
        key = columns[self.used] * shape[0] + rows[self.used]
        unique, self.positions = np.unique(key, return_inverse=True)
        # Without repeated positions a copy in the matrix's order replaces the sum.
        self.order = self.used[np.argsort(self.positions)] if unique.size == key.size else None
        starts = np.searchsorted(unique, np.arange(shape[1] + 1) * shape[0])
        self.matrix = sp.csc_matrix((np.zeros(unique.size), unique % shape[0], starts), shape=shape)

    def __call__(self, data: np.ndarray) -> sp.csc_matrix:
        """Return the matrix with the entries ``data``; entries at the same position are summed."""
        if self.order is not None:
            self.matrix.data = data[self.order]
        else:
            self.matrix.data = np.bincount(self.positions, data[self.used], self.matrix.nnz)
        return self.matrix
