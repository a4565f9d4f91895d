"""Linear programs with complementarity constraints (LPEC) and tests of negative curvature, for certificates."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ocp.programs.solver import without_stdout

if TYPE_CHECKING:
    import scipy.sparse as sp
    from scipy.optimize import OptimizeResult

    from ocp.programs.program import Program

_SNAP = 1e-4
"""Slack, as a fraction of a characteristic size, that counts as zero; for members of pairs a hundredth of this."""
NODES = 500
"""Maximum number of nodes of a branch-and-bound search; unlike a time limit, it does not depend on the load."""


@dataclass(frozen=True)
class LinearModel:
    """First-order model of a problem at a point, in units of characteristic sizes.

    ``minimise cost' d`` subject to ``row_lower <= rows d <= row_upper``, ``lower <= d <= upper``
    and ``0 <= l + d_l ⟂ g + d_g >= 0`` for the pairs at positions ``pairs`` (2, m). Slacks are
    evaluated at the point, and zero if a constraint is active; an equation becomes ``rows d = 0`` even if it has
    a residual, which the audit judges.

    ``cost`` (n,) is the gradient times the sizes, ``rows`` (m_g, n) the Jacobian times the sizes, with
    every row multiplied by a factor ``row_scale`` (m_g,) that brings its largest entry to 1.
    ``typical_change`` is the typical change of the cost (:meth:`~ocp.programs.program.Program.typical_change`).
    """

    cost: np.ndarray
    rows: sp.csr_matrix
    row_lower: np.ndarray
    row_upper: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    pairs: np.ndarray
    members: np.ndarray
    row_scale: np.ndarray
    sizes: np.ndarray
    typical_change: float

    @classmethod
    def at(
        cls, nlp: Program, x: np.ndarray, p: np.ndarray, bounds: dict[str, np.ndarray], residuals: bool = False
    ) -> LinearModel:
        """Return the linear model of a program at x; pairs count only under the reformulation "none".

        With ``residuals`` rows include their violations, so that a direction can reduce them.
        """
        import scipy.sparse as sp

        pairs = nlp.pairs if nlp.reformulation == "none" else np.zeros((2, 0), dtype=int)
        sizes = nlp.sizes(x)
        gradient, g, jacobian = nlp.first_derivatives(x, p)
        scaled = jacobian @ sp.diags(sizes)
        largest = abs(scaled).max(axis=1).toarray().ravel() if g.size else np.zeros(0)
        scale = 1 / np.maximum(largest, 1e-12)
        equal = bounds["lbg"] == bounds["ubg"]
        row_lower, row_upper = (bounds["lbg"] - g) * scale, (bounds["ubg"] - g) * scale
        if not residuals:
            row_lower = np.where(equal, 0.0, _active(row_lower))
            row_upper = np.where(equal, 0.0, -_active(-row_upper))
        return cls(
            gradient * sizes,
            sp.csr_matrix(sp.diags(scale) @ scaled),
            row_lower,
            row_upper,
            _active((bounds["lbx"] - x) / sizes),
            -_active((x - bounds["ubx"]) / sizes),
            pairs,
            np.maximum(x[pairs] / sizes[pairs], 0.0),
            scale,
            sizes,
            nlp.typical_change(x, p, bounds),
        )

    def damped(self, factor: np.ndarray) -> LinearModel:
        """Return the model with sizes multiplied by ``factor`` (n,), which is 1 for members of pairs.

        Active constraints stay active.
        """
        import scipy.sparse as sp

        rows = self.rows @ sp.diags(factor)
        row_factors = 1 / np.maximum(abs(rows).max(axis=1).toarray().ravel(), 1e-12)
        return replace(
            self,
            cost=self.cost * factor,
            rows=sp.csr_matrix(sp.diags(row_factors) @ rows),
            row_lower=self.row_lower * row_factors,
            row_upper=self.row_upper * row_factors,
            lower=self.lower / factor,
            upper=self.upper / factor,
            row_scale=self.row_scale * row_factors,
            sizes=self.sizes * factor,
        )

    @property
    def finite(self) -> bool:
        """Whether no derivative and no constraint is NaN."""
        arrays = (self.cost, self.rows.data, self.row_lower, self.row_upper)
        return not any(np.isnan(array).any() for array in arrays)

    def near(self, radius: float) -> np.ndarray:
        """Return a mask (m,) of pairs that may open or close: both members are within ``radius`` of zero."""
        return np.all(self.members < radius, axis=0)

    def effort(self, radius: float) -> int:
        """Return the cost of a search over branches of near pairs: number of binaries times nonzeros of the rows."""
        return int(self.near(radius).sum()) * self.rows.nnz

    @property
    def held(self) -> np.ndarray:
        """Indices (m,) of the smaller member of every pair."""
        return self.pairs[np.argmin(self.members, axis=0), np.arange(self.pairs.shape[1])]

    @property
    def free(self) -> np.ndarray:
        """Mask (n,) of variables that neither a bound nor a pair fixes."""
        free = (self.lower < 0) & (self.upper > 0)
        free[self.held] = False
        return free

    def reduced(self, multipliers: np.ndarray) -> np.ndarray:
        """Return the gradient (n,) of the Lagrangian, ``cost + rows' y``."""
        return self.cost + self.rows.T @ (multipliers / self.row_scale)

    def box(self, radius: float) -> tuple[np.ndarray, np.ndarray]:
        """Return bounds of ``d / radius`` in the trust region; the smaller member is 0 unless its pair is near."""
        lower = np.maximum(self.lower / radius, -1.0)
        upper = np.minimum(self.upper / radius, 1.0)
        decided = ~self.near(radius)
        zero_members = self.held[decided]
        lower[zero_members] = upper[zero_members] = 0.0
        near_members = self.pairs[:, ~decided]
        lower[near_members] = -self._snapped()[:, ~decided] / radius
        upper[near_members] = 1.0
        return lower, upper

    def _snapped(self) -> np.ndarray:
        return np.where(self.members < _SNAP * 1e-2, 0.0, self.members)

    def dual_bound(self, multipliers: np.ndarray, radius: float) -> float:
        """Return an upper bound on the decrease per radius in the relaxed problem.

        Weak duality: for any multipliers y of the rows, ``-min_d cost' d`` over the box and rows is
        at most ``-sum_i min(r_i lower_i, r_i upper_i) + sum_j max(y_j row_upper_j, y_j
        row_lower_j)`` with ``r = cost + rows' y``. The bound is zero at the multipliers of a strongly
        stationary point.
        """
        y, reduced = multipliers / self.row_scale, self.reduced(multipliers)
        lower, upper = self.box(radius)
        gained = -np.minimum(reduced * lower, reduced * upper).sum()
        ends = np.clip([self.row_lower / radius, self.row_upper / radius], -1e12, 1e12)
        return float(gained + (y * ends).max(axis=0).sum())

    def descend(self, radius: float, branching: bool, min_decrease: float, first: bool = False) -> Descent:
        """Return the steepest feasible direction with ``|d_i| <= radius``.

        Without ``branching`` both members of near pairs may grow (the relaxed problem, a linear program).
        With ``branching`` one member of each near pair stays zero; a binary variable per pair selects it. The
        direction then decreases the cost by more than ``min_decrease`` per radius, and at least half as steeply as the
        steepest direction; with ``first`` the search ends at its first direction. A ``min_decrease`` of minus infinity
        accepts every direction. The step is zero if no direction exists. The search ends after
        :data:`NODES` nodes.
        """
        near_pairs = np.flatnonzero(self.near(radius)) if branching else np.zeros(0, dtype=int)
        n = self.cost.size
        solution = _solved(*self._program(radius, near_pairs, min_decrease), 1e9 if first else 0.5)
        if solution.status == 2 and near_pairs.size:
            return Descent(0.0, np.zeros(n))
        if solution.x is None:
            return Descent(np.nan, np.zeros(n), trouble=str(solution.message))
        step = solution.x[:n]
        decrease = max(0.0, -float(self.cost @ step))
        return Descent(decrease, step, near_pairs, np.round(solution.x[n:]))

    def on_branch(self, relaxed: Descent, radius: float) -> Descent | None:
        """Return the steepest direction without branching if it stays on a branch, else None.

        It is then the steepest of all branches as well, and no integer program is needed.
        """
        if not np.isfinite(relaxed.decrease):
            return None
        near_pairs = np.flatnonzero(self.near(radius))
        ends = self._snapped()[:, near_pairs] / radius + relaxed.step[self.pairs[:, near_pairs]]
        if np.any(ends.min(axis=0) > _ON_BRANCH):
            return None
        return Descent(relaxed.decrease, relaxed.step, near_pairs, (ends[0] > ends[1]).astype(float))

    def _program(
        self, radius: float, near_pairs: np.ndarray, min_decrease: float
    ) -> tuple[np.ndarray, tuple[Any, ...], tuple[Any, ...], np.ndarray]:
        """Return objective, rows, bounds and integrality of the program in the direction and binaries of near pairs."""
        import scipy.sparse as sp

        count, size = near_pairs.size, max(float(np.abs(self.cost).max(initial=0.0)), 1e-300)
        zeros, ones = np.zeros(count), np.ones(count)
        lower, upper = self.box(radius)
        objective = np.concatenate([self.cost / size, zeros])
        rows = [sp.hstack([self.rows, sp.csr_matrix((self.row_scale.size, count))])]
        row_limits = [(self.row_lower / radius, self.row_upper / radius)]
        if count:
            members = self._snapped()[:, near_pairs] / radius
            no_limit = np.full(count, -np.inf)
            rows += [*self._branches(near_pairs, members), sp.csr_matrix(objective)]
            row_limits += [(no_limit, -members[0]), (no_limit, ones), (no_limit[:1], np.array([-min_decrease / size]))]
        low, high = (np.concatenate(limits) for limits in zip(*row_limits, strict=True))
        box = np.concatenate([lower, zeros]), np.concatenate([upper, ones])
        integrality = np.concatenate([np.zeros(self.cost.size), ones])
        return objective, (sp.vstack(rows), low, high), box, integrality

    def _branches(self, near_pairs: np.ndarray, members: np.ndarray) -> list[sp.csr_matrix]:
        """Return the rows ``l + d_l <= z (l + 1)`` and ``g + d_g <= (1 - z) (g + 1)``, all over the radius."""
        import scipy.sparse as sp

        count, n = near_pairs.size, self.cost.size
        entries = np.arange(count), np.ones(count)

        def member_columns(member: int) -> sp.csr_matrix:
            return sp.csr_matrix((entries[1], (entries[0], self.pairs[member, near_pairs])), (count, n))

        return [
            sp.csr_matrix(sp.hstack([member_columns(0), sp.diags(-(members[0] + 1))])),
            sp.csr_matrix(sp.hstack([member_columns(1), sp.diags(members[1] + 1)])),
        ]


_LARGE = 5_000
"""Number of variables above which a linear program is solved by the interior-point method first."""
_ON_BRANCH = 1e-7
"""Value of a pair's smaller member after a step, over the radius, up to which it is zero: HiGHS's own tolerance."""


@dataclass(frozen=True)
class Descent:
    """Steepest descent direction ``step``, the ``decrease`` of the cost per radius, and the selected branch.

    ``active`` is 1 for pairs of ``near`` whose multiplier may grow while the gap stays zero.
    ``decrease`` is NaN if the program was not solved; ``trouble`` says why.
    """

    decrease: float
    step: np.ndarray = field(default_factory=lambda: np.zeros(0))
    near: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=int))
    active: np.ndarray = field(default_factory=lambda: np.zeros(0))
    trouble: str = ""


def _active(negative_slack: np.ndarray) -> np.ndarray:
    """Return lower bounds of a step: negative slacks, and zero if the constraint is active or violated."""
    return np.where(negative_slack > -_SNAP, 0.0, negative_slack)


def _solved(
    objective: np.ndarray, rows: tuple[Any, ...], box: tuple[Any, ...], integrality: np.ndarray, gap: float
) -> OptimizeResult:
    """Return the solution by HiGHS, which runs again without presolve after numerical problems.

    In large programs without integers its interior-point method comes first: it takes a seventh of the simplex's time.
    """
    from scipy.optimize import Bounds, LinearConstraint, milp

    if objective.size > _LARGE and not integrality.any() and (solution := _by_interior_point(objective, rows, box)):
        return solution
    options = {"node_limit": NODES, "mip_rel_gap": gap}
    arguments = {"constraints": LinearConstraint(*rows), "bounds": Bounds(*box), "integrality": integrality}
    with without_stdout():
        solution = milp(objective, options=options, **arguments)
        if solution.status == 4 and "limit" not in solution.message:
            solution = milp(objective, options={**options, "presolve": False}, **arguments)
    return solution


def _by_interior_point(objective: np.ndarray, rows: tuple[Any, ...], box: tuple[Any, ...]) -> OptimizeResult | None:
    """Return the solution of a linear program, whose rows get slacks between their limits, or None if that fails."""
    import scipy.sparse as sp
    from scipy.optimize import linprog

    count, size = rows[1].size, objective.size
    bounds = np.column_stack([np.concatenate(ends) for ends in zip(box, rows[1:], strict=True)])
    matrix, values = sp.hstack([rows[0], -sp.identity(count)], format="csr"), np.append(objective, np.zeros(count))
    with without_stdout():
        solution = linprog(values, A_eq=matrix, b_eq=np.zeros(count), bounds=bounds, method="highs-ipm")
    if solution.status != 0:
        return None
    solution.x = solution.x[:size]
    return solution


_NULL_SPACE_SHIFT = 1e-8
"""Regularisation of the rows when negative eigenvalues are counted."""
_LEAST_CURVATURE = 1e-7
"""Largest absolute value of a negative eigenvalue that counts as zero, as a fraction of the largest entry of H."""


def negative_curvature(hessian: sp.csr_matrix, constraints: sp.csr_matrix) -> int:
    """Return the number of negative eigenvalues of H on the null space of A, -1 if the computation failed.

    H (n, n) is symmetric, A is (m, n). By Haynsworth and Sylvester the matrix ``[[H + e I, A'],
    [A, -e I]]`` has as many negative eigenvalues as H has on the null space of A, and m more, for
    small e; they are counted on the diagonal of its triangular factors, taken with symmetric
    pivots. Eigenvalues above -1e-7 of the largest entry of H do not count as negative.
    """
    import scipy.sparse as sp
    import scipy.sparse.linalg as sla

    n, m = hessian.indptr.size - 1, constraints.indptr.size - 1
    if n == 0:
        return 0
    size = max(float(np.abs(hessian.data).max(initial=0.0)), 1e-300)
    top = sp.identity(n) * _LEAST_CURVATURE + hessian / size
    augmented = sp.bmat([[top, constraints.T], [constraints, -_NULL_SPACE_SHIFT * sp.identity(m)]], format="csc")
    try:
        factors = sla.splu(
            augmented, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
        )
    except RuntimeError:
        return -1
    if not np.array_equal(factors.perm_r, factors.perm_c):
        return -1
    signs = factors.U.diagonal()
    return max(0, int((signs < 0).sum()) - m)
