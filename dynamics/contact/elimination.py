"""Gaussian elimination on symbolic matrices whose pivots are known to be positive."""

from __future__ import annotations

import casadi as ca


def solve_without_pivoting(A: ca.SX, b: ca.SX) -> ca.SX:
    """Solve ``A y = b`` for A (n, n) with positive leading minors, b (n, m), as an SX graph.

    Every P-matrix, and ``diag(s) + diag(lam) F`` with F a P-matrix and s, lam > 0, has only
    positive pivots, so no row exchange is needed and the graph is the same for every value.
    Structural zeros are skipped, so block-diagonal A costs the sum of its blocks.
    """
    n = A.shape[0]
    rows = [[A[i, j] for j in range(n)] for i in range(n)]
    right = [b[i, :] for i in range(n)]
    for pivot in range(n):
        inverse = 1 / rows[pivot][pivot]
        for i in range(pivot + 1, n):
            if _is_zero(rows[i][pivot]):
                continue
            factor = rows[i][pivot] * inverse
            for j in range(pivot + 1, n):
                if not _is_zero(rows[pivot][j]):
                    rows[i][j] = rows[i][j] - factor * rows[pivot][j]
            right[i] = right[i] - factor * right[pivot]
    solution: list[ca.SX] = [right[i] for i in range(n)]
    for i in reversed(range(n)):
        total = right[i]
        for j in range(i + 1, n):
            if not _is_zero(rows[i][j]):
                total = total - rows[i][j] * solution[j]
        solution[i] = total / rows[i][i]
    return ca.vertcat(ca.SX(0, b.shape[1]), *solution)


def _is_zero(entry: ca.SX) -> bool:
    return entry.nnz() == 0 or entry.is_zero()
