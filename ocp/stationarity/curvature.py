"""Inertia of the reduced Hessian: along how many feasible directions a cost curves down."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import scipy.sparse as sp

_REGULAR = 1e-8
_NOISE = 1e-7


def negative_curvature(hessian: sp.csr_matrix, constraints: sp.csr_matrix) -> int:
    """Count the negative eigenvalues of H on the null space of A; -1 where that failed.

    H (n, n) symmetric, A (m, n). By Haynsworth and Sylvester the matrix ``[[H + e I, A'],
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
    top = sp.identity(n) * _NOISE + hessian / size
    whole = sp.bmat([[top, constraints.T], [constraints, -_REGULAR * sp.identity(m)]], format="csc")
    try:
        factors = sla.splu(
            whole, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )  # fmt: skip
    except RuntimeError:
        return -1
    if not np.array_equal(factors.perm_r, factors.perm_c):
        return -1
    signs = factors.U.diagonal()
    return max(0, int((signs < 0).sum()) - m)
