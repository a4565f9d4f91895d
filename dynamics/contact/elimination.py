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
    rows: list[dict[int, ca.SX]] = [{} for _ in range(n)]
    for i, j in zip(*A.sparsity().get_triplet(), strict=True):
        if not A[i, j].is_zero():
            rows[i][j] = A[i, j]
    right = [b[i, :] for i in range(n)]
    for pivot in range(n):
        inverse = 1 / rows[pivot][pivot]
        for i in range(pivot + 1, n):
            if pivot not in rows[i]:
                continue
            factor = rows[i].pop(pivot) * inverse
            for j, entry in rows[pivot].items():
                if j > pivot:
                    rows[i][j] = rows[i].get(j, 0) - factor * entry
            right[i] = right[i] - factor * right[pivot]
    solution: list[ca.SX] = [right[i] for i in range(n)]
    for i in reversed(range(n)):
        total = right[i]
        for j, entry in rows[i].items():
            if j > i:
                total = total - entry * solution[j]
        solution[i] = total / rows[i][i]
    return ca.vertcat(ca.SX(0, b.shape[1]), *solution)
