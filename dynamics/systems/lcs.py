"""Linear complementarity systems, and a test of their well-posedness."""

from __future__ import annotations

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from dynamics.systems.parameters import ParameterTable, Signal
from dynamics.systems.system import ContactSystem


def lcs(
    name: str,
    *,
    A: ArrayLike,
    B: ArrayLike,
    C: ArrayLike,
    D: ArrayLike,
    E: ArrayLike,
    F: ArrayLike,
    c: ArrayLike | None = None,
    d: ArrayLike | None = None,
    states: tuple[Signal, ...] | None = None,
    inputs: tuple[Signal, ...] | None = None,
    contacts: tuple[Signal, ...] | None = None,
    h: ca.SX | float = 1.0,
    parameters: ParameterTable | None = None,
) -> ContactSystem:
    """Build a linear complementarity system (adaptive barrier smoothing, eq. 2.1-2.2).

    ``x+ = A x + B u + C lam + c``, ``0 <= lam ⟂ D x + E u + F lam + d >= 0``; matrices numeric or
    symbolic in ``parameters``. It has one solution for every (x, u) iff F is a P-matrix, see
    :func:`is_p_matrix`. If h is a parameter and ``x+ = x`` at h = 0 without contact, h is only a step size: h/4 gives
    the same system with finer steps.

    Raises ``ValueError`` if a matrix has the wrong shape.
    """
    matrices = {
        key: ca.SX(ca.DM(np.atleast_2d(value))) if not isinstance(value, ca.SX) else value
        for key, value in (("A", A), ("B", B), ("C", C), ("D", D), ("E", E), ("F", F))
    }
    nx, nu, nlam = matrices["A"].shape[0], matrices["B"].shape[1], matrices["F"].shape[0]
    shapes = {"A": (nx, nx), "B": (nx, nu), "C": (nx, nlam), "D": (nlam, nx), "E": (nlam, nu), "F": (nlam, nlam)}
    for key, shape in shapes.items():
        if matrices[key].shape != shape:
            raise ValueError(f"LCS matrix {key} has shape {matrices[key].shape}, expected {shape}")
    x, x_next = ca.SX.sym("x", nx), ca.SX.sym("x_next", nx)
    u, lam = ca.SX.sym("u", nu), ca.SX.sym("lam", nlam)
    m = matrices
    offset_x = ca.SX.zeros(nx) if c is None else _column(c, nx, "c")
    offset_gap = ca.SX.zeros(nlam) if d is None else _column(d, nlam, "d")
    return ContactSystem(
        name=name,
        x=x,
        u=u,
        x_next=x_next,
        lam=lam,
        residual=x_next - (m["A"] @ x + m["B"] @ u + m["C"] @ lam + offset_x),
        gap=m["D"] @ x + m["E"] @ u + m["F"] @ lam + offset_gap,
        states=states or tuple(Signal(f"x{i}", "1") for i in range(nx)),
        inputs=inputs or tuple(Signal(f"u{i}", "1") for i in range(nu)),
        contacts=contacts or tuple(Signal(f"contact{i}", "1") for i in range(nlam)),
        h=h,
        parameters=parameters or ParameterTable(),
        gap_unit="1",
        refinable=_discretises(h, m["A"], m["B"], offset_x),
    )


def _discretises(h: ca.SX | float, A: ca.SX, B: ca.SX, c: ca.SX) -> bool:
    """Return whether h is a symbol and ``A x + B u + c = x`` holds at h = 0 for all x and u."""
    if not isinstance(h, ca.SX) or not h.is_symbolic():
        return False
    A, B, c = ca.substitute([A - ca.SX.eye(A.shape[0]), B, c], [h], [ca.SX(0)])
    return bool(ca.sparsify(ca.simplify(ca.horzcat(A, B, c))).nnz() == 0)


def _column(value: ArrayLike | ca.SX, size: int, name: str) -> ca.SX:
    column = value if isinstance(value, ca.SX) else ca.SX(ca.DM(np.ravel(value)))
    if column.shape != (size, 1):
        raise ValueError(f"LCS vector {name} has shape {column.shape}, expected {(size, 1)}")
    return column


def is_p_matrix(F: ArrayLike) -> bool:
    """Return whether every principal minor of F (n, n) is positive; n may be up to about 16.

    The recursion of Tsatsomeros and Li on Schur complements takes 2^n steps and no determinant: F is a P-matrix iff
    F[0,0] > 0 and both F without row and column 0 and the Schur complement of F[0,0] are P-matrices.
    """
    matrix = np.atleast_2d(np.asarray(F, dtype=float))
    if matrix.shape[0] != matrix.shape[1] or not np.all(np.isfinite(matrix)):
        raise ValueError(f"expected a finite square matrix, got shape {matrix.shape}")
    if matrix.shape[0] == 0:
        return True
    if matrix[0, 0] <= 0:
        return False
    minor = matrix[1:, 1:]
    schur = minor - np.outer(matrix[1:, 0], matrix[0, 1:]) / matrix[0, 0]
    return is_p_matrix(minor) and is_p_matrix(schur)
