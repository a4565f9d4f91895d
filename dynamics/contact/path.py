"""The path solver for systems whose contact is no LCP with a P-matrix: curved gaps, friction.

With ``x_next = a + B lam`` the contact is the nonlinear complementarity problem
``lam gap(a + B lam, lam) = mu``. The path is followed twice, by the iteration of
:mod:`dynamics.contact.interior_point`: first with the gap linearised where the step starts, down to
:data:`MU_LINEAR`, then with the true gap, linearised at every iteration where it stands. Started
right away on the true gap, large trial impulses would spin light bodies round to solutions of no
meaning.
"""

from __future__ import annotations

from functools import cached_property

import casadi as ca

from dynamics.contact import interior_point
from dynamics.systems import ContactSystem, Pair

MU_EXACT = 1e-12
"""The exact law is the path's point at this mu, in scaled units."""
MU_LINEAR = 1e-4
"""Where the path of the linearised gap is left for that of the true one, in scaled units."""
# The linear model of a curved gap promises a better point at every iteration, down to rounding.
_REST = 1e-12
_NEAR = 1e-2
TRUE_GAP = 2.0
"""The number, in the last entry of a pair, of the path of the true gap."""


def scaling(z: ca.SX, F: ca.SX, mu: ca.SX, pairs: tuple[Pair, ...]) -> tuple[ca.SX, ca.SX]:
    """D (n, 1) and c so that ``z D / c`` and ``D F D`` are of order one.

    As :func:`dynamics.contact.interior_point.scaling`; a slip pair, whose F_ii is zero, is scaled
    against the pairs that it meets.
    """
    n = z.numel()
    known = {i: 1 / ca.sqrt(size) for i, size in _sizes(F, pairs).items()}
    D = dict(known)
    for i in set(range(n)) - set(known):
        met = [ca.fabs(F[i, j]) * known[j] for j in known if not F[i, j].is_zero()]
        D[i] = 1 / ca.mmax(ca.vertcat(*met))
    column = ca.vertcat(*(D[i] for i in range(n)))
    size = ca.mmax(ca.vertcat(ca.fabs(z * column), ca.sqrt(mu)))
    return column, ca.fmax(size, 1e-150)


def _sizes(F: ca.SX, pairs: tuple[Pair, ...]) -> dict[int, ca.SX]:
    """Compliance of every pair that has one.

    Friction that drags along the normal may leave little of F_ii, or turn its sign; the compliance
    across the contact is of the size that the normal's was. So it is for a pair of friction whose
    coefficient is zero, which has no compliance of its own.
    """
    own = [i for i in range(len(pairs)) if not F[i, i].is_zero()]
    contact = {"normal", "friction"}
    sizes = {
        i: ca.mmax(ca.vertcat(*(
            ca.fabs(F[i, j]) for j in own
            if j == i or (pairs[i].contact == pairs[j].contact
                          and {pairs[i].kind, pairs[j].kind} == contact)
        )))
        for i in own
    }  # fmt: skip
    normal = {pair.contact: i for i, pair in enumerate(pairs) if pair.kind == "normal"}
    for i, pair in enumerate(pairs):
        if pair.kind == "friction" and normal[pair.contact] in sizes:
            across = sizes[normal[pair.contact]]
            sizes[i] = ca.if_else(sizes[i] > 0, sizes[i], across) if i in sizes else across
    return sizes


class NonlinearPath:
    """The path of one system's step as graphs in a ``pair`` of unknowns and a column of ``data``.

    ``pair`` (2 n + 1, 1) is lam, s in scaled units, and the number of the path that is followed;
    it starts at ones. ``data`` is what the step's state, input and parameters make of the problem:
    for rows of the gap that are affine in lam their scaled z and F, for the others what is needed
    to evaluate them at any lam.
    """

    def __init__(self, system: ContactSystem, exact: bool) -> None:
        self.system, self.exact, self.n = system, exact, system.nlam
        reduced, unknown = system.reduced, ca.vertcat(system.x_next, system.lam)
        self.curved = [
            i for i in range(self.n) if not reduced.affine and _is_curved(system.gap[i], unknown)
        ]  # fmt: skip
        rows = system.gap[self.curved]
        self.states = [
            i for i in range(system.nx) if self.curved and ca.depends_on(rows, system.x_next[i])
        ]
        given = ca.vertcat(system.x, system.u, system.parameters.vector)
        self.given = [
            given[i] for i in range(given.numel()) if self.curved and ca.depends_on(rows, given[i])
        ]
        self.pattern = reduced.F.sparsity()

    def opening(self, mu: ca.SX) -> ca.SX:
        """``data`` as an expression in the system's (x, u, p) and mu (n, 1)."""
        reduced = self.system.reduced
        D, c = scaling(reduced.z_linear, reduced.F, 0 * mu if self.exact else mu, self.system.pairs)
        target = ca.fmax(mu / c**2, interior_point.MU_LEAST)
        if self.exact:
            target = ca.SX.ones(self.n) * MU_EXACT
        F = ca.diag(D) @ reduced.F @ ca.diag(D)
        landing = [reduced.a[self.states], ca.vec(ca.densify(reduced.B[self.states, :]))]
        parts = [reduced.z_linear * D / c, F[self.pattern].nz[:], D, c, target,
                 *(landing if self.curved else []), *self.given]  # fmt: skip
        return ca.densify(ca.vertcat(*parts))

    @cached_property
    def symbols(self) -> dict[str, ca.SX]:
        """Symbols of the parts of ``data``, by name."""
        sizes = {"z": self.n, "F": self.pattern.nnz(), "D": self.n, "c": 1, "mu": self.n,
                 "a": len(self.states), "B": len(self.states) * self.n,
                 "given": len(self.given)}  # fmt: skip
        return {name: ca.SX.sym(name, size) for name, size in sizes.items()}

    @property
    def data(self) -> ca.SX:
        """The symbols of ``data`` in one column."""
        return ca.vertcat(*self.symbols.values())

    def iteration(self) -> ca.Function:
        """One iteration, ``(pair, data) -> pair``; a pair that has arrived is left as it is."""
        n, known = self.n, self.symbols
        pair = ca.SX.sym("pair", 2 * n + 1)
        lam, s, phase = pair[:n], pair[n : 2 * n], pair[2 * n]
        true = phase == TRUE_GAP if self.curved else ca.SX(1)
        z, F = self.linearised(lam, true)
        mu = ca.if_else(true, known["mu"], ca.fmax(known["mu"], MU_LINEAR))
        moved = interior_point.advance(lam, s, z, F, mu, _REST)
        off = ca.mmax(ca.vertcat(ca.fabs(lam * s - mu) / mu, ca.fabs(z + F @ lam - s) / (1 + s)))
        following = ca.if_else(off < _NEAR, TRUE_GAP, phase) if self.curved else phase
        return ca.Function("path_ncp", [pair, self.data], [ca.vertcat(*moved, following)])

    def linearised(self, lam: ca.SX, true: ca.SX) -> tuple[ca.SX, ca.SX]:
        """``gap = z + F lam`` around lam, or around the start of the step where not ``true``."""
        known = self.symbols
        z, F = ca.SX(known["z"]), ca.SX(self.pattern, known["F"])
        if self.curved:
            rows, slopes = self._curved_rows(lam)
            for k, i in enumerate(self.curved):
                z[i] = ca.if_else(true, rows[k] - slopes[k, :] @ lam, z[i])
                F[i, :] = ca.if_else(true, slopes[k, :], ca.densify(F[i, :]))
        return z, F

    def _curved_rows(self, lam: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Scaled gaps of the curved rows at scaled lam, and their derivatives by it."""
        system, known = self.system, self.symbols
        D, c = known["D"], known["c"]
        at = c * D * lam
        B = ca.reshape(known["B"], len(self.states), self.n)
        rows, states = system.gap[self.curved], system.x_next[self.states]
        by_state, by_lam = ca.jacobian(rows, states), ca.jacobian(rows, system.lam)
        old = ca.vertcat(*self.given, states, system.lam)
        new = ca.vertcat(known["given"], known["a"] + B @ at, at)
        rows, by_state, by_lam = ca.substitute([rows, by_state, by_lam], [old], [new])
        scale = D[self.curved]
        return rows * scale / c, ca.diag(scale) @ (by_lam + by_state @ B) @ ca.diag(D)

    def ending(self) -> ca.Function:
        """Out of the scaling: ``(pair, data) -> (lam, gap, error)``, see :func:`ncp_solver`."""
        n, known = self.n, self.symbols
        pair = ca.SX.sym("pair", 2 * n + 1)
        lam, s = pair[:n], pair[n : 2 * n]
        D, c, mu = known["D"], known["c"], known["mu"]
        z, F = self.linearised(lam, ca.SX(1))
        error = ca.fmax(ca.fabs(lam * s - mu), ca.fabs(z + F @ lam - s) / (1 + s))
        # Diverged: not a number, which would pass for small in a comparison.
        error = ca.if_else(error < ca.inf, error, ca.inf)
        outputs = [ca.densify(value) for value in (c * D * lam, s * c / D, error)]
        return ca.Function("ending", [pair, self.data], outputs)


def _is_curved(expression: ca.SX, unknown: ca.SX) -> bool:
    return ca.depends_on(ca.jacobian(expression, unknown), unknown)
