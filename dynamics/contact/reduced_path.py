"""The path of a step whose many contacts push few coordinates, without the matrix between them."""

from __future__ import annotations

from functools import cached_property

import casadi as ca

from dynamics.contact.compliance import Coordinates, LowRank
from dynamics.contact.path import MU_EXACT, MU_LEAST, CurvedGap, Path, scaling
from dynamics.systems import ContactSystem


def path_of(system: ContactSystem, exact: bool) -> Path:
    """The path of a system's step whatever its gaps are; see :meth:`Path.opening_of`.

    Where inertia changes with the state, as a machine's does, and there are more pairs than
    coordinates, the products of both are not worth forming.
    """
    if system.configured:
        coordinates = Coordinates(system)
        if coordinates.r < system.nlam:
            return ReducedPath(system, exact, coordinates)
    return Path.of_system(system, exact)


class ReducedPath(Path):
    """The path with ``F = E + Q T^-1 P`` in its factors, see :class:`LowRank`."""

    def __init__(self, system: ContactSystem, exact: bool, coordinates: Coordinates) -> None:
        curved = None if system.reduced.affine else CurvedGap(system)
        if curved and not curved.rows:
            curved = None
        self.coordinates, self._system = coordinates, system
        here = ca.vertcat(system.unmoved, ca.SX.zeros(system.nlam))
        unknown = ca.vertcat(system.x_next, system.lam)
        self._E, self._Q = ca.substitute([coordinates.E, coordinates.Q_own], [unknown], [here])
        super().__init__(self._E.sparsity(), exact, system.pairs, curved, False)

    @cached_property
    def _factors(self) -> dict[str, ca.SX]:
        """E, T, P and Q at the start of the step, in units of the system."""
        return {"E": self._E, "T": self.coordinates.T, "P": self.coordinates.P_own, "Q": self._Q}

    @property
    def n_entries(self) -> int:
        """Numbers in ``data`` that make up F: those of its factors."""
        return sum(factor.nnz() for factor in self._factors.values())

    def opening_of(self, system: ContactSystem, mu: ca.SX) -> ca.SX:
        """``data`` of a step as an expression in the system's (x, u, p) and mu (n, 1)."""
        own, reduced, signs = self.coordinates.own, system.reduced, self.coordinates.Q_signs
        z = reduced.z if reduced.affine else reduced.z_linear
        D, c = scaling(z, self._near(), 0 * mu if self.exact else mu, self.pairs, reduced.z)
        D = ca.fabs(signs) @ D[own]
        target = mu * 0 + MU_EXACT if self.exact else ca.fmax(mu / c**2, MU_LEAST)
        factors = self._factors
        scaled = {
            "E": ca.diag(D) @ factors["E"] @ ca.diag(D),
            "T": factors["T"],
            "P": factors["P"] @ ca.diag(D[own]),
            "Q": ca.diag(D[own]) @ factors["Q"],
        }
        entries = [ca.vec(ca.project(scaled[name], factors[name].sparsity()).nz[:]) for name in scaled]
        return ca.densify(ca.vertcat(z * D / c, *entries, target, 1 / target, D, c, self.more))

    @property
    def more(self) -> ca.SX:
        """What curved rows need, the last numbers of ``data``."""
        return self.curved.opening_along(self.coordinates.C) if self.curved else ca.SX(0, 1)

    def _near(self) -> ca.SX:
        """Entries of F between the pairs of one contact, which set the scales, and E."""
        factors, coordinates = self._factors, self.coordinates
        system, E = self._system, factors["E"]
        low = LowRank(E, factors["T"], factors["P"], coordinates.P_signs, factors["Q"], coordinates.Q_signs)
        columns = low.by_own()
        near = ca.SX(E)
        kinds = {"normal", "friction", "limit"}
        for i, one in enumerate(system.pairs):
            for j, other in enumerate(system.pairs):
                if one.contact == other.contact and {one.kind, other.kind} <= kinds:
                    k = coordinates.P_signs[:, j].sparsity().row()
                    near[i, j] = E[i, j] + coordinates.Q_signs[i, :] @ (
                        factors["Q"] @ (columns[:, k] @ coordinates.P_signs[k, j])
                    )
        return near

    def compliance(self, entries: ca.SX) -> LowRank:
        """F at the start of the step."""
        factors, ends = list(self._factors.values()), [0]
        for factor in factors:
            ends.append(ends[-1] + factor.nnz())
        parts = ca.vertsplit(entries, ends)
        E, T, P, Q = (ca.SX(factor.sparsity(), part) for factor, part in zip(factors, parts, strict=True))
        return LowRank(E, T, P, self.coordinates.P_signs, Q, self.coordinates.Q_signs)

    def at(self, lam: ca.SX, true: ca.SX) -> tuple[ca.SX, LowRank]:
        """The gap at lam and its compliance there, or as where the step starts, if not ``true``."""
        known = self.known
        start = self.compliance(known["entries"])
        if not self.curved:
            return known["z"] + start.across(lam), start
        w = start.pushed(lam)
        gap = known["z"] + start.felt(lam, w)
        D, c = known["D"], known["c"]
        E, Q = ca.SX(start.E), ca.SX(start.Q_own)
        rows, by_lam, by_w = self.curved.along(c * D * lam, c * w, self.coordinates.C, known["more"])
        for k, i in enumerate(self.curved.rows):
            own = self.coordinates.Q_signs[i, :].sparsity().get_col()[0]
            # Opposite walls share one row but for its sign.
            by_own = self.coordinates.Q_signs[i, own] * by_w[k, :]
            gap[i] = ca.if_else(true, rows[k] * D[i] / c, gap[i])
            Q[own, :] = _chosen(true, D[i] * by_own, Q[own, :])
            E[i, :] = _chosen(true, D[i] * by_lam[k, :] * D.T, E[i, :])
        return gap, LowRank(E, start.T, start.P_own, start.P_signs, Q, start.Q_signs)


def _chosen(condition: ca.SX, one: ca.SX, other: ca.SX) -> ca.SX:
    """``if_else`` entry by entry where ``other`` has any."""
    pattern = other.sparsity()
    one = ca.project(one, pattern)
    return ca.SX(pattern, ca.if_else(condition, one.nz[:], other.nz[:])) if other.nnz() else other
