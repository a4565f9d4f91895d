"""The central path of one complementarity problem, ``lam gap(lam) = mu``, as graphs.

Rows of the gap that are affine in lam are ``z + F lam``; if all rows are affine, the problem is a linear
complementarity problem. With curved rows the iteration of :mod:`dynamics.contact.interior_point` first follows
the path of the gap linearised at the start of the step, down to :data:`MU_LINEAR`, and then the path of the
true gap, linearised at every iterate. If the iteration started on the true gap, large trial impulses would rotate
light bodies by whole turns, to solutions without physical meaning.
"""

from __future__ import annotations

from functools import cached_property

import casadi as ca

from dynamics.contact import interior_point
from dynamics.contact.compliance import Compliance, DenseCompliance
from dynamics.systems import ContactSystem, Pair
from dynamics.systems.elimination import solve_without_pivoting


class CurvedGap:
    """The rows of ``gap(a + B lam, lam)`` that are not affine in lam; ``rows`` are their indices."""

    def __init__(self, system: ContactSystem) -> None:
        self._system, unknown = system, ca.vertcat(system.x_next, system.lam)
        _, gap = system.without_rotations
        slopes = ca.jacobian(gap, unknown)
        self.rows = [i for i in range(system.nlam) if ca.depends_on(slopes[i, :], unknown)]
        self._gap = gap[self.rows]
        self._states = [i for i in range(system.nx) if ca.depends_on(self._gap, system.x_next[i])]
        step_symbols = ca.vertcat(system.x, system.u, system.parameters.vector)
        used_entries = [i for i in range(step_symbols.numel()) if ca.depends_on(self._gap, step_symbols[i])]
        self._step_symbols = step_symbols[used_entries]

    def gap_at(self, lam: ca.SX, D: ca.SX, c: ca.SX, opening: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return the scaled gaps of the curved rows at scaled lam, and their derivatives by scaled lam."""
        impulses, dense = c * D * lam, ca.SX.ones(self._system.nx, lam.numel())
        rows, by_lam, by_w = self.gaps_along(impulses, impulses, dense, opening)
        scale = D[self.rows]
        return rows * scale / c, ca.diag(scale) @ (by_lam + by_w) @ ca.diag(D)

    def opening_data(self, C: ca.SX | None = None) -> ca.SX:
        """Return the column ``opening`` of :meth:`gaps_along`, or of :meth:`gap_at` if C is None, from (x, u, p)."""
        C = ca.densify(self._system.reduced.B) if C is None else C
        return ca.vertcat(self._system.reduced.a[self._states], ca.vec(C[self._states, :].nz[:]), self._step_symbols)

    def gaps_along(self, lam: ca.SX, w: ca.SX, C: ca.SX, opening: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Return the gaps of the curved rows at ``x_next = a + C w``, and their derivatives by lam and by w.

        Only the sparsity of C is used; ``opening`` contains its values.
        """
        system, count = self._system, len(self._states)
        pattern = C[self._states, :].sparsity()
        ends = [0, count, count + pattern.nnz(), opening.numel()]
        a, entries, step_values = ca.vertsplit(opening, ends)
        C = ca.SX(pattern, entries)
        states = system.x_next[self._states]
        by_state, by_lam = ca.jacobian(self._gap, states), ca.jacobian(self._gap, system.lam)
        symbols = ca.vertcat(self._step_symbols, states, system.lam)
        values = ca.vertcat(step_values, a + C @ w, lam)
        rows, by_state, by_lam = ca.substitute([self._gap, by_state, by_lam], [symbols], [values])
        return rows, by_lam, by_state @ C


MU_EXACT = 1e-12
"""mu in scaled units at the end of the path for the exact law, whose solution is this end or is on its active set."""
MU_LEAST = 1e-14
"""Minimum mu in scaled units; the path solver raises smaller values, which rounding would dominate, to this value."""
MU_LINEAR = 1e-4
"""mu in scaled units at which the path changes from the linearised gap to the true one."""
# Scaled errors of products and gaps below which the path changes from the linearised to the true gap.
_SWITCH_ERROR = 1e-2
# Relative error of products at which a path ends; the last iteration squares it. Where F is singular,
# or belongs to a curved gap, the test of progress by the linear model would never end the path.
_PRODUCT_TOLERANCE = 1e-7
# Error of gaps in scaled units at which a path ends.
_GAP_TOLERANCE = 1e-9
# Ratio lam / s at the path's end below which a pair is inactive; lam and s are both 1e-6 if the ratio is one.
_INACTIVE_RATIO = 1e-2
# Minimum of the scale of gaps, relative to a curved gap.
_CURVED_SHARE = 1e-6
# Minimum compliance of a pair, relative to the largest compliance, which replaces smaller values.
_MIN_COMPLIANCE_SHARE = 1e-12
MAX_ERROR = 1e-7
"""Scaled violation above which the end of a path is not accepted as a solution."""
TRUE_GAP = 2.0
"""Phase (last entry of a pair) on the path of the true gap; on the path of the linearised gap the phase is 1."""
ARRIVED = 3.0
"""Phase (last entry of a pair) at the end of its path."""
DIVERGED = 4.0
"""Phase (last entry of a pair) once one of its numbers is not finite."""


class Path:
    """The central path of one contact problem as graphs in a ``pair`` of unknowns and a column of ``data``.

    ``pair`` (size, 1) has lam and s in scaled units and the phase: 1 while curved rows are linearised
    (the start is a pair with all entries 1), :data:`TRUE_GAP` while they are not, :data:`ARRIVED` at the end,
    :data:`DIVERGED` once numbers are not finite. ``data`` describes the problem of one step:
    scaled z, F, mu, 1/mu, the scales D and c, and the data of curved rows.

    ``pattern`` is the sparsity of F (n, n). Without ``system`` F is a P-matrix and the multipliers are
    ``unique``; the exact law is then the solution on the path's active set, complementary to rounding.
    Otherwise the active pairs stay at the path's end, and lam of inactive pairs is set to zero.
    """

    def __init__(self, pattern: ca.Sparsity, exact: bool, system: ContactSystem | None = None) -> None:
        self.pattern, self.exact, self.unique = pattern, exact, system is None
        self.pairs = system.pairs if system else ()
        curved = None if system is None or system.reduced.affine else CurvedGap(system)
        self.curved = curved if curved and curved.rows else None
        self.n = pattern.size1()
        self.size = 2 * self.n + 1

    @classmethod
    def of_system(cls, system: ContactSystem, exact: bool) -> Path:
        """Return the path of solutions in mu of a step of ``system``, whose gaps may be curved."""
        return cls(system.reduced.F.sparsity(), exact, system)

    @property
    def n_entries(self) -> int:
        """Number of entries of ``data`` that represent F."""
        return self.pattern.nnz()

    def opening_data_of(self, system: ContactSystem, mu: ca.SX) -> ca.SX:
        """Return the path's ``data`` for a step, an expression in the system's (x, u, p) and in mu (n, 1)."""
        reduced = system.reduced
        return self.opening_data(reduced.z_linear, reduced.F, mu, reduced.z)

    def opening_data(self, z: ca.SX, F: ca.SX, mu: ca.SX, true_gap: ca.SX | None = None) -> ca.SX:
        """Return ``data`` of the problem ``lam (z + F lam) = mu``, z and mu (n, 1), F (n, n).

        The scaled unknowns lam' = lam / (c D), s' = s D / c with mu' = mu / c² have the same path. With
        ``exact`` mu is ignored and replaced by :data:`MU_EXACT`. ``true_gap`` are the true gaps at lam = 0, if z is
        their linear model.
        """
        D, c = scale_factors(z, F, 0 * mu if self.exact else mu, self.pairs, true_gap)
        target = mu * 0 + MU_EXACT if self.exact else ca.fmax(mu / c**2, MU_LEAST)
        F = ca.project(ca.diag(D) @ F @ ca.diag(D), self.pattern)
        return ca.densify(ca.vertcat(z * D / c, ca.vec(F.nz[:]), target, 1 / target, D, c, self.curved_data))

    @property
    def curved_data(self) -> ca.SX:
        """Data of the curved rows, the last entries of ``data``; empty if all rows are affine."""
        return self.curved.opening_data() if self.curved else ca.SX(0, 1)

    @cached_property
    def data(self) -> ca.SX:
        """Symbols of ``data`` as one column."""
        return ca.SX.sym("data", 4 * self.n + self.n_entries + 1 + self.curved_data.numel())

    def split_data(self, data: ca.SX) -> dict[str, ca.SX]:
        """Split ``data`` into z, entries of F, mu, per_mu, D, c, and "more" (the data of curved rows)."""
        n, offsets = self.n, [0]
        for length in (n, self.n_entries, n, n, n, 1):
            offsets.append(offsets[-1] + length)
        names = ("z", "entries", "mu", "per_mu", "D", "c", "more")
        return dict(zip(names, ca.vertsplit(data, [*offsets, data.numel()]), strict=True))

    @cached_property
    def data_parts(self) -> dict[str, ca.SX]:
        """Symbols of the parts of ``data``, see :meth:`split_data`."""
        return self.split_data(self.data)

    def pack_pair(self, lam: ca.SX, s: ca.SX, phase: ca.SX | float = TRUE_GAP) -> ca.SX:
        """Return the column ``pair`` made of lam, s and the phase."""
        return ca.vertcat(lam, s, phase)

    def iteration_function(self) -> ca.Function:
        """Return the function ``(pair, data) -> pair`` of one iteration; a pair at the end of its path is unchanged."""
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
        new_phase = ca.if_else(product_error + gap_error < ca.inf, new_phase, ca.fmax(phase, DIVERGED))
        new_pair = self.pack_pair(*new_pair, new_phase)
        resting_pair = ca.vertcat(pair[: 2 * n], ca.if_else(phase < ARRIVED, new_phase, phase))
        return ca.Function(f"path_{n}", [pair, self.data], [ca.if_else(is_moving, new_pair, resting_pair)])

    def gap_at(self, lam: ca.SX, on_true_gap: ca.SX) -> tuple[ca.SX, Compliance]:
        """Return the scaled gap at lam and its compliance.

        If ``on_true_gap`` holds, this is the true gap, else the gap linearised at the start of the step.
        """
        entries = self.data_parts
        z, F = ca.SX(entries["z"]), ca.SX(self.pattern, entries["entries"])
        if self.curved:
            rows, slopes = self.curved.gap_at(lam, entries["D"], entries["c"], entries["more"])
            for k, i in enumerate(self.curved.rows):
                z[i] = ca.if_else(on_true_gap, rows[k] - slopes[k, :] @ lam, z[i])
                F[i, :] = ca.if_else(on_true_gap, slopes[k, :], ca.densify(F[i, :]))
        return z + F @ lam, DenseCompliance(F)

    def true_gap_at(self, lam: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return the scaled true gap at lam, and its derivative by lam (n, n)."""
        gap, F = self.gap_at(lam, ca.SX(1))
        return gap, F.matrix()

    def ending_function(self) -> ca.Function:
        """Return the function ``(pair, data) -> (lam, gap, error)`` of the solution, each (n, 1).

        lam (impulse) and gap are in the caller's units; ``error`` is each contact's scaled violation, the larger of
        ``|lam s - mu|`` and ``|z + F lam - s| / (1 + s)``, infinite after divergence.
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
        # Diverged iterates give NaN, which a comparison would treat as small.
        error = ca.if_else(error < ca.inf, error, ca.inf)
        if self.exact and not self.unique:
            new_lam, new_s = _without_inactive(lam, s, F)
        outputs = [ca.densify(value) for value in (c * D * new_lam, new_s * c / D, error)]
        return ca.Function("ending", [pair, self.data], outputs)


def _on_active_set(lam: ca.SX, s: ca.SX, z: ca.SX, F: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return lam and s of the linear system on the active set {lam > s} if they are feasible, else unchanged."""
    active = lam > s
    projector = ca.diag(active)
    matrix = projector @ F + ca.SX.eye(lam.numel()) - projector
    on_set = solve_without_pivoting(matrix, -active * z)
    gap = (1 - active) * (z + F @ on_set)
    # Redundant contacts do not determine the forces on the active set; then the path's end is used.
    gap_error = ca.mmax(ca.fabs(active * (z + F @ on_set)))
    valid = ca.logic_and(ca.mmin(ca.vertcat(on_set, gap)) >= -1e-9, gap_error <= 1e-9)
    return ca.if_else(valid, ca.fmax(0, on_set), lam), ca.if_else(valid, ca.fmax(0, gap), s)


def _without_inactive(lam: ca.SX, s: ca.SX, F: Compliance) -> tuple[ca.SX, ca.SX]:
    """Return lam and s at the path's end with inactive lam set exactly to zero.

    The active pairs change along ``lam ds + s dlam = 0``, which is valid also for redundant contacts.
    """
    active = lam > _INACTIVE_RATIO * s
    step, opened = F.factorise(active * lam / s)((active - 1) * lam)
    new_lam, new_s = ca.if_else(active, lam + step, 0), s + opened
    valid = ca.mmin(ca.vertcat(new_lam, new_s)) >= -1e-9
    return ca.if_else(valid, ca.fmax(0, new_lam), lam), ca.if_else(valid, ca.fmax(0, new_s), s)


def scale_factors(
    z: ca.SX, F: ca.SX, mu: ca.SX, pairs: tuple[Pair, ...], true_gap: ca.SX | None = None
) -> tuple[ca.SX, ca.SX]:
    """Return scales D (n, 1) and a scalar c so that ``z D / c`` and ``D F D`` are of order one.

    c is such that a curved gap, ``true_gap`` at lam = 0, is at most a million in scaled units, since its
    linear model may be zero.

    A pair without compliance, such as a slip pair, is scaled by the pairs to which it is coupled; a table pair is
    scaled like the other table pairs of its body. Without ``pairs`` F must be a P-matrix; a negative F_ii then
    gives NaN.
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
        # No impulse changes this gap, for example between parts that never move.
        fallback = ca.mmin(ca.vertcat(*scale_of.values())) if scale_of else ca.SX(1)
        D[i] = 1 / ca.mmax(ca.vertcat(*coupled_scales)) if coupled_scales else fallback
    scales = ca.vertcat(ca.SX(0, 1), *(D[i] for i in range(n)))
    curved_sizes = ca.SX(0, 1) if true_gap is None else _CURVED_SHARE * ca.fabs(true_gap * scales)
    magnitude = ca.mmax(ca.vertcat(ca.fabs(z * scales), curved_sizes, ca.sqrt(mu)))
    return scales, ca.fmax(magnitude, 1e-150)


def _sizes(F: ca.SX, pairs: tuple[Pair, ...]) -> dict[int, ca.SX]:
    """Return a dict from the index of each pair with compliance to the magnitude of this compliance.

    Friction may make F_ii of a normal pair small or negative; the entries of F between normal and
    friction pairs of the contact have the magnitude of F_ii without friction. A friction pair without
    compliance, as for a coefficient of zero, has the magnitude of its contact's normal pair.
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
            normal_size = sizes[normal[pair.contact]]
            sizes[i] = ca.if_else(sizes[i] > 0, sizes[i], normal_size) if i in sizes else normal_size
    largest = ca.mmax(ca.vertcat(0, *sizes.values()))
    # F_ii may be zero in some states: a tip straight below its hinge moves along the ground only.
    return {i: ca.if_else(size > _MIN_COMPLIANCE_SHARE * largest, size, largest) for i, size in sizes.items()}
