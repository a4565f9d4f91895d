"""Compliance F of gaps under impulses, ``gap = z + F lam``, and the linear systems of the path solver.

F (n, n) is a matrix or, if many contacts act on few coordinates, a product of factors that is never formed.
Both kinds solve ``(I + diag(ratio) F) step = rhs``, ratio = lam / s.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import casadi as ca
import numpy as np

from dynamics.systems import ContactSystem
from dynamics.systems.elimination import LUFactors, solve_without_pivoting

LinearSolver = Callable[[ca.SX], tuple[ca.SX, ca.SX]]


class Compliance(Protocol):
    """Interface of the compliance F (n, n) of a contact problem."""

    def multiply(self, lam: ca.SX) -> ca.SX:
        """Return ``F lam`` (n, 1)."""
        ...

    def factorise(self, ratio: ca.SX) -> LinearSolver:
        """Return the solver ``rhs -> (step, F step)`` of ``(I + diag(ratio) F) step = rhs``."""
        ...

    def matrix(self) -> ca.SX:
        """Return the compliance as a matrix F (n, n)."""
        ...


@dataclass(frozen=True, eq=False)
class DenseCompliance:
    """Compliance F as a sparse or dense matrix."""

    F: ca.SX

    def multiply(self, lam: ca.SX) -> ca.SX:
        """Return ``F lam`` (n, 1)."""
        return self.F @ lam

    def factorise(self, ratio: ca.SX) -> LinearSolver:
        """Return the solver ``rhs -> (step, F step)``, see :class:`Compliance`."""
        factors = LUFactors(ca.SX.eye(ratio.numel()) + ca.diag(ratio) @ self.F)

        def solve(rhs: ca.SX) -> tuple[ca.SX, ca.SX]:
            step = factors.solve(rhs)
            return step, self.F @ step

        return solve

    def matrix(self) -> ca.SX:
        """Return the compliance as a matrix F (n, n)."""
        return self.F


class PushedCoordinates:
    """The few coordinates w (r, 1) of the next state that all impulses of a system act on.

    ``x_next = a + C w`` with ``T w = P lam``, and ``gap = g(x_next, lam)`` with ``Q = dg/dx_next
    C`` and ``E = dg/dlam``, so that ``F = E + Q T^-1 P``. Pairs whose columns of P and rows of Q are
    equal up to their sign, such as the two directions of friction, share one column of ``P_reduced`` and
    one row of ``Q_reduced``: ``P = P_reduced P_signs``, ``Q = Q_signs Q_reduced``; ``representatives`` are
    the indices of these n_reduced pairs. C, T, P are expressions in the state, the input and the parameters; Q
    and E also in the next state and lam.
    """

    def __init__(self, system: ContactSystem) -> None:
        residual, gap = system.without_rotations
        by_state = ca.jacobian(residual, system.x_next)
        by_lam = ca.jacobian(residual, system.lam)
        pushed = sorted(set(by_lam.sparsity().get_triplet()[0]))
        free = [i for i in range(system.nx) if i not in pushed]
        free_by_pushed = -solve_without_pivoting(by_state[free, free], by_state[free, pushed])
        C = ca.SX(system.nx, len(pushed))
        C[free, :], C[pushed, :] = free_by_pushed, ca.SX.eye(len(pushed))
        self.r, self.C = len(pushed), ca.sparsify(C)
        self.T = by_state[pushed, pushed] + by_state[pushed, free] @ free_by_pushed
        by_next = ca.jacobian(gap, system.x_next)
        P, Q = -by_lam[pushed, :], ca.sparsify(by_next @ self.C)
        self.representatives, self.P_signs, self.Q_signs = _representative_pairs(system, P, Q)
        self.P_reduced, self.Q_reduced = P[:, self.representatives], Q[self.representatives, :]
        self.E = ca.jacobian(gap, system.lam)


_PROBES = 8
"""Number of random points at which two pairs are compared."""
_PROBE_REACH = 1.5
"""Maximum absolute value of a coordinate of a random point."""
_SWITCHES = frozenset(
    (*(ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE, ca.OP_IF_ELSE_ZERO, ca.OP_FMIN, ca.OP_FMAX, ca.OP_FABS, ca.OP_SIGN),)
)
"""CasADi operations that select a formula depending on their operands."""


def _representative_pairs(system: ContactSystem, P: ca.SX, Q: ca.SX) -> tuple[list[int], ca.DM, ca.DM]:
    """Return the indices of representative pairs, ``P_signs`` (n_reduced, n) and ``Q_signs`` (n, n_reduced).

    A pair is represented by another pair if their columns of P and rows of Q are equal up to sign at random
    points. If formulas switch, as at the faces of a box, two contacts may agree only in one region; only
    pairs of the same contact then represent each other.
    """
    symbols = ca.vertcat(system.x, system.u, system.parameters.vector, system.x_next, system.lam)
    rng, probe = np.random.default_rng(0), ca.Function("probe", [symbols], [P.T, Q])
    points = rng.uniform(-_PROBE_REACH, _PROBE_REACH, (_PROBES, symbols.numel()))
    points[: _PROBES // 2] = rng.uniform(0.5, _PROBE_REACH, (_PROBES // 2, symbols.numel()))
    values = [[np.array(matrix) for matrix in probe(point)] for point in points]
    columns, rows = (np.hstack(matrices) for matrices in zip(*values, strict=True))
    switches = [_has_switch(symbols, ca.vertcat(P[:, i], Q[i, :].T)) for i in range(len(rows))]
    switched, contacts = np.array(switches), np.array([pair.contact for pair in system.pairs])
    representatives: list[int] = []
    signs = [ca.DM(len(rows), len(rows)) for _ in range(2)]
    for i in range(len(rows)):
        others = np.array(representatives, dtype=int)
        by_column, by_row = (_relative_signs(vectors[i], vectors[others]) for vectors in (columns, rows))
        comparable = (contacts[others] == contacts[i]) | ~(switched[others] | switched[i])
        alike = np.flatnonzero(comparable & (by_column != 0) & (by_row != 0))
        k = int(alike[0]) if alike.size else len(representatives)
        representatives += [] if alike.size else [i]
        signs[0][i, k], signs[1][i, k] = (int(by_column[k]), int(by_row[k])) if alike.size else (1, 1)
    return representatives, signs[0][:, : len(representatives)].T, signs[1][:, : len(representatives)]


def _has_switch(symbols: ca.SX, expression: ca.SX) -> bool:
    """Return whether an expression contains an operation that switches between formulas."""
    graph = ca.Function("graph", [symbols], [ca.densify(expression)])
    return any(graph.instruction_id(k) in _SWITCHES for k in range(graph.n_instructions()))


def _relative_signs(vector: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return for each row of ``others`` (m, size) 1 if ``vector`` equals it, -1 if it equals its negative, else 0."""
    tolerance = 1e-12 * np.nanmax(np.abs(vector), initial=0)
    equal, opposite = (np.all(np.nan_to_num(np.abs(vector - k * others)) <= tolerance, axis=1) for k in (1, -1))
    return np.where(equal, 1, np.where(opposite, -1, 0))


@dataclass(frozen=True, eq=False)
class LowRankCompliance:
    """Compliance ``F = E + Q T^-1 P``, see :class:`PushedCoordinates`; E is sparse, T (r, r) is small.

    Linear systems are reduced to ``(T + P K^-1 diag(ratio) Q) w = P K^-1 rhs``, K = I + diag(ratio) E.
    """

    E: ca.SX
    T: ca.SX
    P_reduced: ca.SX
    P_signs: ca.DM
    Q_reduced: ca.SX
    Q_signs: ca.DM

    def solve_coordinates(self, lam: ca.SX) -> ca.SX:
        """Return the coordinates ``w = T^-1 P lam`` (r, 1) under impulses lam."""
        return solve_without_pivoting(self.T, self._push_coordinates(lam))

    def gap_change(self, lam: ca.SX, w: ca.SX) -> ca.SX:
        """Return the change of the gaps ``E lam + Q w`` (n, 1) under impulses lam and coordinates w."""
        return self.E @ lam + self.Q_signs @ (self.Q_reduced @ w)

    def reduced_response(self) -> ca.SX:
        """Return ``T^-1 P`` (r, n_reduced) of the representative pairs."""
        return solve_without_pivoting(self.T, self.P_reduced)

    def multiply(self, lam: ca.SX) -> ca.SX:
        """Return ``F lam`` (n, 1)."""
        return self.gap_change(lam, self.solve_coordinates(lam))

    def factorise(self, ratio: ca.SX) -> LinearSolver:
        """Return the solver ``rhs -> (step, F step)``, see :class:`Compliance`."""
        local_factors = LUFactors(ca.SX.eye(ratio.numel()) + ca.diag(ratio) @ self.E)
        weights = self.P_signs @ local_factors.solve(ca.diag(ratio) @ self.Q_signs)
        reduced_factors = LUFactors(self.T + self.P_reduced @ (weights @ self.Q_reduced))

        def solve(rhs: ca.SX) -> tuple[ca.SX, ca.SX]:
            w = reduced_factors.solve(self._push_coordinates(local_factors.solve(rhs)))
            step = local_factors.solve(rhs - ratio * (self.Q_signs @ (self.Q_reduced @ w)))
            return step, self.gap_change(step, w)

        return solve

    def matrix(self) -> ca.SX:
        """Return the compliance as a matrix F (n, n)."""
        return self.E + self.Q_signs @ (self.Q_reduced @ self.reduced_response()) @ self.P_signs

    def _push_coordinates(self, lam: ca.SX) -> ca.SX:
        return self.P_reduced @ (self.P_signs @ lam)
