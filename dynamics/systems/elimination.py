"""Gaussian elimination on symbolic matrices whose pivots are known to be positive."""

from __future__ import annotations

import casadi as ca


class LUFactors:
    """``A = L U`` as an SX graph, for A (n, n) with positive leading minors.

    Every P-matrix, and ``diag(s) + diag(lam) F`` with F a P-matrix and s, lam > 0, has only
    positive pivots, so no row exchange is needed and the graph is the same for every value.
    Structural zeros are skipped, so block-diagonal A costs the sum of its blocks.
    """

    def __init__(self, A: ca.SX) -> None:
        n = A.shape[0]
        A = ca.sparsify(A)
        # Columns of each row, fill-in last, so that sums keep their order.
        columns: list[dict[int, None]] = [{} for _ in range(n)]
        for i, j in zip(*A.sparsity().get_triplet(), strict=True):
            columns[i][j] = None
        self._lower: list[dict[int, ca.SX]] = [{} for _ in range(n)]
        self._upper: list[dict[int, ca.SX]] = []
        self._inverse_pivots: list[ca.SX] = []
        for pivot in range(n):
            inverse = 1 / A[pivot, pivot]
            self._inverse_pivots.append(inverse)
            column, row = A[:, pivot], A[pivot, :]
            below = [i for i in column.sparsity().row() if i > pivot]
            right_columns = [j for j in columns[pivot] if j > pivot]
            self._upper.append({j: row[j] for j in right_columns})
            if not below:
                continue
            factors = ca.densify(column[below]) * inverse
            for i, factor in zip(below, ca.vertsplit(factors), strict=True):
                self._lower[i][pivot] = factor
                columns[i] |= dict.fromkeys(right_columns)
            if right_columns:
                # A single product updates all entries, so that a graph of thousands of nodes is built in milliseconds.
                A[below, right_columns] -= factors @ ca.densify(row[right_columns]).reshape((1, -1))

    def solve(self, b: ca.SX) -> ca.SX:
        """Return y (n, m) with ``A y = b``, b (n, m)."""
        solution = [b[i, :] for i in range(len(self._upper))]
        for i, row in enumerate(self._lower):
            for j, factor in row.items():
                solution[i] = solution[i] - factor * solution[j]
        for i in reversed(range(len(solution))):
            for j, entry in self._upper[i].items():
                solution[i] = solution[i] - entry * solution[j]
            solution[i] = solution[i] * self._inverse_pivots[i]
        return ca.vertcat(ca.SX(0, b.shape[1]), *solution)


def solve_without_pivoting(A: ca.SX, b: ca.SX) -> ca.SX:
    """Solve ``A y = b`` for A (n, n) with positive leading minors, see :class:`LUFactors`."""
    return LUFactors(A).solve(b)


def solve_in_order(A: ca.SX, b: ca.SX, order: list[int], refinements: int) -> ca.SX:
    """Solve ``A y = b``, eliminating rows and columns in this ``order``, then refine the solution.

    An order that keeps A sparse may give pivots that are small relative to their rows. Each of the
    ``refinements`` adds the solution for ``b - A y``, which reduces the rounding error due to such pivots.
    """
    ordered, factors = A[order, order], LUFactors(A[order, order])
    y = factors.solve(b[order, :])
    for _ in range(refinements):
        y = y + factors.solve(b[order, :] - ordered @ y)
    back = [order.index(i) for i in range(len(order))]
    return y[back, :]
