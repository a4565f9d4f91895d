"""The central path of a step whose many contacts act on few coordinates, without forming the compliance matrix."""

from __future__ import annotations

from functools import cached_property

import casadi as ca

from dynamics.contact.compliance import LowRankCompliance, PushedCoordinates
from dynamics.contact.path import MU_EXACT, MU_LEAST, Path, scale_factors
from dynamics.systems import ContactSystem
from dynamics.systems.elimination import solve_without_pivoting

MANY_PAIRS = 30
"""Number of pairs from which a dense compliance is not formed: elimination takes two thirds of its cube of operations.

Eight discs and a finger have 144 pairs on 26 coordinates: an iteration of their path takes 55 thousand operations with
the factors, and 2.1 million with the matrix.
"""


def path_of(system: ContactSystem, exact: bool) -> Path:
    """Return the path of one step of ``system``, whose gaps may be curved.

    The path is a :class:`ReducedPath` if inertia depends on the state, as in a machine, or if there are at least
    :data:`MANY_PAIRS`, and if the impulses of the pairs act on fewer coordinates than there are pairs.
    """
    if system.has_variable_inertia or system.nlam >= MANY_PAIRS:
        coordinates = PushedCoordinates(system)
        if coordinates.r < system.nlam:
            return ReducedPath(system, exact, coordinates)
    return Path.of_system(system, exact)


class ReducedPath(Path):
    """Central path with the compliance ``F = E + Q T^-1 P`` stored as its factors, see :class:`LowRankCompliance`."""

    def __init__(self, system: ContactSystem, exact: bool, coordinates: PushedCoordinates) -> None:
        self.coordinates, self._system = coordinates, system
        expansion_point = ca.vertcat(system.expansion_state, ca.SX.zeros(system.nlam))
        unknown = ca.vertcat(system.x_next, system.lam)
        self._E, self._Q = ca.substitute([coordinates.E, coordinates.Q_reduced], [unknown], [expansion_point])
        super().__init__(self._E.sparsity(), exact, system)

    @cached_property
    def _factors(self) -> dict[str, ca.SX]:
        """E, T, P and Q linearised at the start of the step, in the system's units."""
        return {"E": self._E, "T": self.coordinates.T, "P": self.coordinates.P_reduced, "Q": self._Q}

    @property
    def n_entries(self) -> int:
        """Number of entries of ``data`` that represent F: the nonzeros of its factors."""
        return sum(factor.nnz() for factor in self._factors.values())

    def opening_data_of(self, system: ContactSystem, mu: ca.SX) -> ca.SX:
        """Return the path's ``data`` for a step, an expression in the system's (x, u, p) and in mu (n, 1)."""
        representatives, reduced, signs = self.coordinates.representatives, system.reduced, self.coordinates.Q_signs
        z = reduced.z if reduced.affine else reduced.z_linear
        D, c = scale_factors(z, self._local_compliance(), 0 * mu if self.exact else mu, self.pairs, reduced.z)
        D = ca.fabs(signs) @ D[representatives]
        target = mu * 0 + MU_EXACT if self.exact else ca.fmax(mu / c**2, MU_LEAST)
        factors = self._factors
        scaled = {
            "E": ca.diag(D) @ factors["E"] @ ca.diag(D),
            "T": factors["T"],
            "P": factors["P"] @ ca.diag(D[representatives]),
            "Q": ca.diag(D[representatives]) @ factors["Q"],
        }
        entries = [ca.vec(ca.project(scaled[name], factors[name].sparsity()).nz[:]) for name in scaled]
        return ca.densify(ca.vertcat(z * D / c, *entries, target, 1 / target, D, c, self.curved_data))

    @property
    def curved_data(self) -> ca.SX:
        """Data of the curved rows, the last entries of ``data``; empty if all rows are affine."""
        return self.curved.opening_data(self.coordinates.C) if self.curved else ca.SX(0, 1)

    def _local_compliance(self) -> ca.SX:
        """Return the part of F that determines the scales: E, and the entries of F between pairs of one contact."""
        factors, coordinates = self._factors, self.coordinates
        system, E = self._system, factors["E"]
        columns = solve_without_pivoting(factors["T"], factors["P"])
        local_F = ca.SX(E)
        kinds = {"normal", "friction", "limit"}
        for i, pair in enumerate(system.pairs):
            for j, other in enumerate(system.pairs):
                if pair.contact == other.contact and {pair.kind, other.kind} <= kinds:
                    k = coordinates.P_signs[:, j].sparsity().row()
                    local_F[i, j] = E[i, j] + coordinates.Q_signs[i, :] @ (
                        factors["Q"] @ (columns[:, k] @ coordinates.P_signs[k, j])
                    )
        return local_F

    def compliance_at_start(self, entries: ca.SX) -> LowRankCompliance:
        """Return the scaled compliance F linearised at the start of the step, from its entries in ``data``."""
        factors, offsets = list(self._factors.values()), [0]
        for factor in factors:
            offsets.append(offsets[-1] + factor.nnz())
        blocks = ca.vertsplit(entries, offsets)
        E, T, P, Q = (ca.SX(factor.sparsity(), block) for factor, block in zip(factors, blocks, strict=True))
        return LowRankCompliance(E, T, P, self.coordinates.P_signs, Q, self.coordinates.Q_signs)

    def gap_at(self, lam: ca.SX, on_true_gap: ca.SX) -> tuple[ca.SX, LowRankCompliance]:
        """Return the scaled gap at lam and its compliance, see :meth:`Path.gap_at`."""
        entries = self.data_parts
        start = self.compliance_at_start(entries["entries"])
        if not self.curved:
            return entries["z"] + start.multiply(lam), start
        w = start.solve_coordinates(lam)
        gap = entries["z"] + start.gap_change(lam, w)
        D, c = entries["D"], entries["c"]
        E, Q = ca.SX(start.E), ca.SX(start.Q_reduced)
        rows, by_lam, by_w = self.curved.gaps_along(c * D * lam, c * w, self.coordinates.C, entries["more"])
        for k, i in enumerate(self.curved.rows):
            representative = self.coordinates.Q_signs[i, :].sparsity().get_col()[0]
            # Two opposite walls share one row, with opposite signs.
            by_pushed = self.coordinates.Q_signs[i, representative] * by_w[k, :]
            gap[i] = ca.if_else(on_true_gap, rows[k] * D[i] / c, gap[i])
            Q[representative, :] = _select_nonzeros(on_true_gap, D[i] * by_pushed, Q[representative, :])
            E[i, :] = _select_nonzeros(on_true_gap, D[i] * by_lam[k, :] * D.T, E[i, :])
        return gap, LowRankCompliance(E, start.T, start.P_reduced, start.P_signs, Q, start.Q_signs)


def _select_nonzeros(condition: ca.SX, chosen: ca.SX, default: ca.SX) -> ca.SX:
    """Return ``if_else(condition, chosen, default)`` of two matrices, only at the nonzeros of ``default``."""
    pattern = default.sparsity()
    chosen = ca.project(chosen, pattern)
    return ca.SX(pattern, ca.if_else(condition, chosen.nz[:], default.nz[:])) if default.nnz() else default
