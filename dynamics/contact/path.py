"""The central path of one complementarity problem, ``lam gap(lam) = mu``, as graphs.

Rows of the gap that are affine in lam are ``z + F lam``: with these alone it is a linear
complementarity problem. Curved rows are followed twice, by the iteration of
:mod:`dynamics.contact.interior_point`: first linearised where the step starts, down to
:data:`MU_LINEAR`, then as they are, linearised at every iteration where it stands. Started right
away on the true gap, large trial impulses would spin light bodies round to solutions of no meaning.
"""

from __future__ import annotations

from functools import cached_property

import casadi as ca

from dynamics.contact import interior_point
from dynamics.contact.compliance import Compliance, DenseCompliance
from dynamics.systems import ContactSystem, Pair
from dynamics.systems.elimination import solve_without_pivoting


class CurvedGap:
    """Curved rows of ``gap(a + B lam, lam)``; ``rows`` are their numbers."""

    def __init__(self, system: ContactSystem) -> None:
        self._system, unknown = system, ca.vertcat(system.x_next, system.lam)
        _, gap = system.without_rotations
        slopes = ca.jacobian(gap, unknown)
        self.rows = [i for i in range(system.nlam) if ca.depends_on(slopes[i, :], unknown)]
        self._gap = gap[self.rows]
        self._states = [i for i in range(system.nx) if ca.depends_on(self._gap, system.x_next[i])]
        step_symbols = ca.vertcat(system.x, system.u, system.parameters.vector)
        used_entries = [i for i in range(step_symbols.numel()) if ca.depends_on(self._gap, step_symbols[i])]
        self._given = step_symbols[used_entries]

    @property
    def opening_data(self) -> ca.SX:
        """Data for :meth:`gap_at`, in the system's (x, u, p)."""
        return self.opening_data_along(ca.densify(self._system.reduced.B))

    def gap_at(self, lam: ca.SX, D: ca.SX, c: ca.SX, opening: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Scaled gaps of the rows at scaled lam, and their derivatives by it."""
        impulses, dense = c * D * lam, ca.SX.ones(self._system.nx, lam.numel())
        rows, by_lam, by_w = self.gaps_along(impulses, impulses, dense, opening)
        scale = D[self.rows]
        return rows * scale / c, ca.diag(scale) @ (by_lam + by_w) @ ca.diag(D)

    def opening_data_along(self, C: ca.SX) -> ca.SX:
        """Data for :meth:`gaps_along`, in the system's (x, u, p)."""
        return ca.vertcat(self._system.reduced.a[self._states], ca.vec(C[self._states, :].nz[:]), self._given)

    def gaps_along(self, lam: ca.SX, w: ca.SX, C: ca.SX, opening: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Gaps of the rows where ``x_next = a + C w``, and their derivatives by lam and by w.

        Of C the pattern counts; its numbers are in ``opening``.
        """
        system, count = self._system, len(self._states)
        pattern = C[self._states, :].sparsity()
        ends = [0, count, count + pattern.nnz(), opening.numel()]
        a, entries, step_values = ca.vertsplit(opening, ends)
        C = ca.SX(pattern, entries)
        states = system.x_next[self._states]
        by_state, by_lam = ca.jacobian(self._gap, states), ca.jacobian(self._gap, system.lam)
        symbols = ca.vertcat(self._given, states, system.lam)
        values = ca.vertcat(step_values, a + C @ w, lam)
        rows, by_state, by_lam = ca.substitute([self._gap, by_state, by_lam], [symbols], [values])
        return rows, by_lam, by_state @ C


MU_EXACT = 1e-12
"""The exact law is the path's point at this mu, in scaled units, or that point's active set."""
MU_LEAST = 1e-14
"""A smaller scaled mu is rounding to the path solver and is raised to this."""
MU_LINEAR = 1e-4
"""Where the path of the linearised gap is left for that of the true one, in scaled units."""
# Errors of products and gaps, scaled, below which a linearised path changes to the true gap.
_SWITCH_ERROR = 1e-2
# Violations of products, relative, and of gaps, which one more iteration squares: where F is
# singular, or belongs to a curved gap, the linear model promises a better point for ever.
_PRODUCT_TOLERANCE = 1e-7
# The same for gaps, in scaled units.
_GAP_TOLERANCE = 1e-9
# A pair with a smaller lam / s is inactive at the path's end, where both are 1e-6 if neither is.
_INACTIVE_RATIO = 1e-2
# Of a curved gap: the scale is at least so much of it.
_CURVED_SHARE = 1e-6
# Of the largest compliance of a pair: less is none, and the largest stands in its place.
_MIN_COMPLIANCE_SHARE = 1e-12
TRUE_GAP = 2.0
"""Last entry of a pair while the true gap is followed; 1 while its linear model is."""
ARRIVED = 3.0
"""Last entry of a pair at the end of its path."""
LOST = 4.0
"""Last entry of a pair whose numbers are no longer finite."""


class Path:
    """The path of one problem as graphs in a ``pair`` of unknowns and a column of ``data``.

    ``pair`` (size, 1) is lam, s in scaled units and where it stands: 1, with which it starts at
    ones, while curved rows are linearised, :data:`TRUE_GAP` while they are followed as they are,
    :data:`ARRIVED` at the end, :data:`LOST` where numbers are no longer finite. ``data`` is what a
    step's state, input and parameters make of the problem: scaled z, F, mu, 1/mu, the scales D and
    c, and what curved rows need.

    ``pattern`` is that of F (n, n). Where F is a P-matrix, ``unique``, the multipliers are unique;
    then the exact law is the solution on the path's active set, complementary to rounding. Where
    it is none the active pairs stay at the path's end, and the lam of inactive ones is zero.
    """

    def __init__(
        self,
        pattern: ca.Sparsity,
        exact: bool,
        pairs: tuple[Pair, ...] = (),
        curved: CurvedGap | None = None,
        unique: bool = True,
    ) -> None:
        self.pattern, self.exact, self.unique, self.curved = pattern, exact, unique, curved
        self.n = pattern.size1()
        self.pairs = pairs
        self.size = 2 * self.n + 1

    @classmethod
    def of_system(cls, system: ContactSystem, exact: bool) -> Path:
        """The path of a system's step whatever its gaps are; see :meth:`opening_data_of`."""
        curved = None if system.reduced.affine else CurvedGap(system)
        pattern = system.reduced.F.sparsity()
        return cls(pattern, exact, system.pairs, curved if curved and curved.rows else None, False)

    @property
    def n_entries(self) -> int:
        """Numbers in ``data`` that make up F."""
        return self.pattern.nnz()

    def opening_data_of(self, system: ContactSystem, mu: ca.SX) -> ca.SX:
        """Return the path's ``data`` for a step, as an expression in the system's (x, u, p) and mu (n, 1)."""
        reduced = system.reduced
        return self.opening_data(reduced.z_linear, reduced.F, mu, reduced.z)

    def opening_data(self, z: ca.SX, F: ca.SX, mu: ca.SX, true_gap: ca.SX | None = None) -> ca.SX:
        """``data`` of the problem ``lam (z + F lam) = mu``, z and mu (n, 1), F (n, n).

        In scaled numbers lam' = lam / (c D), s' = s D / c and mu' = mu / c²: the path is the same.
        With ``exact`` mu is ignored and :data:`MU_EXACT` stands in its place. ``true_gap`` are curved
        gaps at lam = 0, of which z is the linear model.
        """
        D, c = scale_factors(z, F, 0 * mu if self.exact else mu, self.pairs, true_gap)
        target = mu * 0 + MU_EXACT if self.exact else ca.fmax(mu / c**2, MU_LEAST)
        F = ca.project(ca.diag(D) @ F @ ca.diag(D), self.pattern)
        return ca.densify(ca.vertcat(z * D / c, ca.vec(F.nz[:]), target, 1 / target, D, c, self.curved_data))

    @property
    def curved_data(self) -> ca.SX:
        """Data of the curved rows, the last numbers of ``data``."""
        return self.curved.opening_data if self.curved else ca.SX(0, 1)

    @cached_property
    def data(self) -> ca.SX:
        """The symbols of ``data`` in one column."""
        return ca.SX.sym("data", 4 * self.n + self.n_entries + 1 + self.curved_data.numel())

    def split_data(self, data: ca.SX) -> dict[str, ca.SX]:
        """Take ``data`` apart: z, entries of F, mu, per_mu, D, c, and what curved rows need."""
        n, offsets = self.n, [0]
        for length in (n, self.n_entries, n, n, n, 1):
            offsets.append(offsets[-1] + length)
        names = ("z", "entries", "mu", "per_mu", "D", "c", "more")
        return dict(zip(names, ca.vertsplit(data, [*offsets, data.numel()]), strict=True))

    @cached_property
    def data_parts(self) -> dict[str, ca.SX]:
        """The :meth:`split_data` of the symbols of ``data``."""
        return self.split_data(self.data)

    def pack_pair(self, lam: ca.SX, s: ca.SX, phase: ca.SX | float = TRUE_GAP) -> ca.SX:
        """Put lam, s and where they stand together."""
        return ca.vertcat(lam, s, phase)

    def iteration_function(self) -> ca.Function:
        """One iteration, ``(pair, data) -> pair``; a pair that has arrived is left as it is."""
        n, mu, per_mu = self.n, self.data_parts["mu"], self.data_parts["per_mu"]
        pair = ca.SX.sym("pair", self.size)
        lam, s, phase, on_true_gap = pair[:n], pair[n : 2 * n], pair[2 * n], ca.SX(1)
        if self.curved:
            on_true_gap = phase == TRUE_GAP
            mu = ca.if_else(on_true_gap, mu, ca.fmax(mu, MU_LINEAR))
            per_mu = ca.if_else(on_true_gap, per_mu, ca.fmin(per_mu, 1 / MU_LINEAR))
        gap, F = self.gap_at(lam, on_true_gap)
        new_pair = interior_point.advance_pair(lam, s, gap, F, mu, per_mu)
        weight = ca.fmin(per_mu, 1 / interior_point.FLOOR)
        product_error, gap_error = ca.mmax(ca.fabs(lam * s - mu) * weight), ca.mmax(ca.fabs(gap - s))
        is_moving, new_phase = phase < ARRIVED, phase
        if self.unique:
            at_rest = interior_point.has_settled((lam, s), new_pair, gap, F, mu)
            new_phase, is_moving = ca.if_else(at_rest, ARRIVED, new_phase), ca.logic_and(is_moving, 1 - at_rest)
        else:
            is_converged = ca.logic_and(product_error < _PRODUCT_TOLERANCE, gap_error < _GAP_TOLERANCE)
            new_phase = ca.if_else(ca.logic_and(on_true_gap, is_converged), ARRIVED, new_phase)
        if self.curved:
            is_near = ca.logic_and(product_error < _SWITCH_ERROR, gap_error < _SWITCH_ERROR)
            new_phase = ca.if_else(ca.logic_and(1 - on_true_gap, is_near), TRUE_GAP, new_phase)
        new_phase = ca.if_else(product_error + gap_error < ca.inf, new_phase, ca.fmax(phase, LOST))
        new_pair = self.pack_pair(*new_pair, new_phase)
        resting_pair = ca.vertcat(pair[: 2 * n], ca.if_else(phase < ARRIVED, new_phase, phase))
        return ca.Function(f"path_{n}", [pair, self.data], [ca.if_else(is_moving, new_pair, resting_pair)])

    def gap_at(self, lam: ca.SX, on_true_gap: ca.SX) -> tuple[ca.SX, Compliance]:
        """The gap at lam and its compliance there, or as where the step starts, if not ``on_true_gap``."""
        entries = self.data_parts
        z, F = ca.SX(entries["z"]), ca.SX(self.pattern, entries["entries"])
        if self.curved:
            rows, slopes = self.curved.gap_at(lam, entries["D"], entries["c"], entries["more"])
            for k, i in enumerate(self.curved.rows):
                z[i] = ca.if_else(on_true_gap, rows[k] - slopes[k, :] @ lam, z[i])
                F[i, :] = ca.if_else(on_true_gap, slopes[k, :], ca.densify(F[i, :]))
        return z + F @ lam, DenseCompliance(F)

    def true_gap_at(self, lam: ca.SX) -> tuple[ca.SX, ca.SX]:
        """The true gap at lam, and its derivative by lam (n, n)."""
        gap, F = self.gap_at(lam, ca.SX(1))
        return gap, F.matrix()

    def ending_function(self) -> ca.Function:
        """Out of the scaling: ``(pair, data) -> (lam, gap, error)``, each (n, 1).

        lam (impulse) and the gap are the caller's; ``error`` is each contact's scaled violation,
        the larger one of ``|lam s - mu|`` and ``|z + F lam - s| / (1 + s)``.
        """
        n, entries = self.n, self.data_parts
        pair = ca.SX.sym("pair", self.size)
        lam, s, D, c, target_mu = pair[:n], pair[n : 2 * n], entries["D"], entries["c"], entries["mu"]
        gap, F = self.gap_at(lam, ca.SX(1))
        new_lam, new_s = lam, s
        if self.exact and self.unique:
            new_lam, new_s = _on_active_set(lam, s, entries["z"], F.matrix())
            target_mu, gap = ca.SX(0), gap + F.multiply(new_lam - lam)
        error = ca.fmax(ca.fabs(new_lam * new_s - target_mu), ca.fabs(gap - new_s) / (1 + s))
        # Diverged: not a number, which would pass for small in a comparison.
        error = ca.if_else(error < ca.inf, error, ca.inf)
        if self.exact and not self.unique:
            new_lam, new_s = _without_inactive(lam, s, F)
        outputs = [ca.densify(value) for value in (c * D * new_lam, new_s * c / D, error)]
        return ca.Function("ending", [pair, self.data], outputs)


def _on_active_set(lam: ca.SX, s: ca.SX, z: ca.SX, F: ca.SX) -> tuple[ca.SX, ca.SX]:
    """The solution of the linear system on {lam > s}, where that is feasible."""
    active = lam > s
    projector = ca.diag(active)
    matrix = projector @ F + ca.SX.eye(lam.numel()) - projector
    on_set = solve_without_pivoting(matrix, -active * z)
    gap = (1 - active) * (z + F @ on_set)
    # Redundant contacts leave the forces on the active set open: then the path's end stands.
    gap_error = ca.mmax(ca.fabs(active * (z + F @ on_set)))
    valid = ca.logic_and(ca.mmin(ca.vertcat(on_set, gap)) >= -1e-9, gap_error <= 1e-9)
    return ca.if_else(valid, ca.fmax(0, on_set), lam), ca.if_else(valid, ca.fmax(0, gap), s)


def _without_inactive(lam: ca.SX, s: ca.SX, F: Compliance) -> tuple[ca.SX, ca.SX]:
    """lam and s at the path's end once inactive lam are zero, to the bit.

    The active ones follow along ``lam ds + s dlam = 0``, which stands where forces are open too.
    """
    active = lam > _INACTIVE_RATIO * s
    step, opened = F.factorise(active * lam / s)((active - 1) * lam)
    new_lam, new_s = ca.if_else(active, lam + step, 0), s + opened
    valid = ca.mmin(ca.vertcat(new_lam, new_s)) >= -1e-9
    return ca.if_else(valid, ca.fmax(0, new_lam), lam), ca.if_else(valid, ca.fmax(0, new_s), s)


def scale_factors(
    z: ca.SX, F: ca.SX, mu: ca.SX, pairs: tuple[Pair, ...], true_gap: ca.SX | None = None
) -> tuple[ca.SX, ca.SX]:
    """D (n, 1) and a scalar c so that ``z D / c`` and ``D F D`` are of order one.

    A curved gap, ``true_gap`` at lam = 0, is no more than a million: its linear model may be zero.

    A slip pair, whose F_ii is zero, is scaled against the pairs that it meets, a way slid on a
    table as the body's other ways. Without ``pairs`` F
    is a P-matrix; where it is not, the path of a negative F_ii is not a number from its start.
    """
    n = z.numel()
    sizes = _sizes(F, pairs) if pairs else {i: F[i, i] for i in range(n)}
    scale_of = {i: 1 / ca.sqrt(magnitude) for i, magnitude in sizes.items()}
    D = dict(scale_of)
    for i in set(range(n)) - set(scale_of):
        same_body = [scale_of[k] for k in scale_of if pairs[i].kind == "table" and pairs[k] == pairs[i]]
        if same_body:
            D[i] = same_body[0]
            continue
        coupled_scales = [ca.fabs(F[i, j]) * scale_of[j] for j in scale_of if not F[i, j].is_zero()]
        # A gap that no impulse changes, as between parts that never move, has no scale of its own.
        fallback = ca.mmin(ca.vertcat(*scale_of.values())) if scale_of else ca.SX(1)
        D[i] = 1 / ca.mmax(ca.vertcat(*coupled_scales)) if coupled_scales else fallback
    scales = ca.vertcat(ca.SX(0, 1), *(D[i] for i in range(n)))
    curved_sizes = ca.SX(0, 1) if true_gap is None else _CURVED_SHARE * ca.fabs(true_gap * scales)
    magnitude = ca.mmax(ca.vertcat(ca.fabs(z * scales), curved_sizes, ca.sqrt(mu)))
    return scales, ca.fmax(magnitude, 1e-150)


def _sizes(F: ca.SX, pairs: tuple[Pair, ...]) -> dict[int, ca.SX]:
    """Compliance of every pair that has one.

    Friction that drags along the normal may leave little of F_ii, or turn its sign; the compliance
    across the contact is of the size that the normal's was. So it is for a pair of friction whose
    coefficient is zero, which has no compliance of its own.
    """
    compliant = [i for i in range(len(pairs)) if not F[i, i].is_zero()]
    contact_kinds = {"normal", "friction"}
    sizes = {
        i: ca.mmax(
            ca.vertcat(
                *(
                    ca.fabs(F[i, j])
                    for j in compliant
                    if j == i
                    or (pairs[i].contact == pairs[j].contact and {pairs[i].kind, pairs[j].kind} == contact_kinds)
                )
            )
        )
        for i in compliant
    }
    normal = {pair.contact: i for i, pair in enumerate(pairs) if pair.kind == "normal"}
    for i, pair in enumerate(pairs):
        if pair.kind == "friction" and normal[pair.contact] in sizes:
            across = sizes[normal[pair.contact]]
            sizes[i] = ca.if_else(sizes[i] > 0, sizes[i], across) if i in sizes else across
    largest = ca.mmax(ca.vertcat(0, *sizes.values()))
    # A tip straight below its hinge moves along the ground alone: there its F_ii is zero.
    return {i: ca.if_else(size > _MIN_COMPLIANCE_SHARE * largest, size, largest) for i, size in sizes.items()}
