"""Quadratic model of the costs on the branches around a solved one."""

from __future__ import annotations

import numpy as np

from ocp.judge.lpec import LinearModel
from ocp.programs.solver import Result
from ocp.routes.branches import Branches

_SHIFT = 1e-9
"""Regularisation of curvature and rows, as a fraction of the largest curvature and of the largest row entries."""


class BranchModel:
    """Predicted costs of branches that differ from a solved branch in few of the given ``pairs``.

    With ``d`` in characteristic sizes, the model is ``r'd + d'Hd / 2`` subject to ``A d = 0`` of the active rows: H is
    the Hessian of the Lagrangian, and r its gradient, zero for free variables and the multipliers of held members. When
    a pair changes sides, its held member h is released, and its other member m is moved to zero:

        [K  B] [z]   [ 0]    K = [H  A'], B = columns of K for the members h, unit vectors for the members m,
        [B' C] [w] = [-s]        [A  0 ]  s = r_h for the members h, x_m for the members m, C = H of the members h,

    so that one factorisation of K serves all branches, which differ in few rows and columns of the Schur complement
    ``C - B' K^-1 B``. The cost changes by ``(r_h' d_h + x_m' v_m) / 2`` with ``w = (d_h, v_m)``. Bounds and
    inequalities with a multiplier stay active, the others are ignored.
    """

    def __init__(self, branches: Branches, result: Result, active: np.ndarray, pairs: np.ndarray) -> None:
        """Factorise the model; raises RuntimeError if its matrix is singular."""
        import scipy.sparse as sp
        import scipy.sparse.linalg as sla

        program, x, lam_g = branches.program, result.point.x, result.point.lam_g
        assert lam_g is not None
        model = LinearModel.at(program, x, branches.p, branches.limits)
        hessian = program.scaled_hessian(x, branches.p, lam_g, model.sizes)
        self.pairs, (first, second) = pairs, program.pairs
        released, zeroed = np.where(active, (second, first), (first, second))[:, pairs]
        reduced, rows, least = (
            model.reduced(lam_g),
            lam_g / model.row_scale,
            branches.min_multiplier * program.natural.f,
        )
        held = ((model.lower == 0) & (reduced > least)) | ((model.upper == 0) & (reduced < -least))
        held[np.where(active, second, first)] = True
        lower, upper = model.row_lower == 0, model.row_upper == 0
        acting = (lower & upper) | (lower & (rows < -least)) | (upper & (rows > least))
        self.unit = max(float(np.abs(hessian.data).max(initial=0.0)), 1e-300)
        H, A, free = sp.csc_matrix(hessian / self.unit), sp.csc_matrix(model.rows[acting]), np.flatnonzero(~held)
        n, m = free.size, int(acting.sum())
        top = H[free][:, free] + _SHIFT * sp.identity(n)
        K = sp.bmat([[top, A[:, free].T], [A[:, free], -_SHIFT * sp.identity(m)]], format="csc")
        unit_vectors = sp.csc_matrix(sp.identity(x.size))[:, zeroed][free]
        B = sp.bmat([[H[free][:, released], unit_vectors], [A[:, released], None]], format="csc")
        factors = sla.splu(K)
        # Column by column: SuperLU solves several columns by calls of BLAS, whose threads cost more than they save.
        self.schur = -B.T @ np.column_stack([factors.solve(column) for column in B.toarray().T])
        count = pairs.size
        self.schur[:count, :count] += H[released][:, released].toarray()
        # The other member of a pair at (0, 0) may be held already.
        is_held = np.concatenate([np.full(count, False), held[zeroed]])
        self.schur[is_held, is_held] = 1.0
        distances = np.where(held[zeroed], 0.0, (x / model.sizes)[zeroed])
        self.right = np.concatenate([reduced[released] / self.unit, distances])

    def change(self, changed: np.ndarray) -> float:
        """Return the predicted change of the cost if the ``changed`` pairs (m,) change sides; inf if there is none."""
        members = np.flatnonzero(changed[self.pairs])
        released, zeroed = members, members + self.pairs.size
        while True:
            unknowns = np.concatenate([released, zeroed])
            try:
                w = np.linalg.solve(self.schur[np.ix_(unknowns, unknowns)], -self.right[unknowns])
            except np.linalg.LinAlgError:
                return np.inf
            opening = w[: released.size] > 0
            if opening.all():
                # A branch without a point nearby has a nearly singular system, whose solution may overflow.
                with np.errstate(all="ignore"):
                    change = self.unit * float(self.right[unknowns] @ w) / 2
                return change if np.isfinite(change) else np.inf
            released = released[opening]
