"""The rows of a system's gap that are curved in the multipliers, along the path of a step."""

from __future__ import annotations

from functools import cached_property

import casadi as ca

from dynamics.systems import ContactSystem


class CurvedGap:
    """Curved rows of ``gap(a + B lam, lam)``; ``rows`` are their numbers."""

    def __init__(self, system: ContactSystem) -> None:
        self._system, unknown = system, ca.vertcat(system.x_next, system.lam)
        slopes = ca.jacobian(system.gap, unknown)
        self.rows = [i for i in range(system.nlam) if ca.depends_on(slopes[i, :], unknown)]
        self._gap = system.gap[self.rows]
        self._states = [i for i in range(system.nx) if ca.depends_on(self._gap, system.x_next[i])]
        given = ca.vertcat(system.x, system.u, system.parameters.vector)
        used = [i for i in range(given.numel()) if ca.depends_on(self._gap, given[i])]
        self._given = given[used]

    @cached_property
    def opening(self) -> ca.SX:
        """What is needed to evaluate the rows at any lam, in the system's (x, u, p)."""
        reduced, states = self._system.reduced, self._states
        affine = [reduced.a[states], ca.vec(ca.densify(reduced.B[states, :]))]
        return ca.vertcat(*affine, self._given)

    def at(self, lam: ca.SX, D: ca.SX, c: ca.SX, opening: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Scaled gaps of the rows at scaled lam, and their derivatives by it."""
        system, count, n = self._system, len(self._states), lam.numel()
        a, B, given = ca.vertsplit(opening, [0, count, count * (1 + n), opening.numel()])
        at, B = c * D * lam, ca.reshape(B, count, n)
        states = system.x_next[self._states]
        by_state, by_lam = ca.jacobian(self._gap, states), ca.jacobian(self._gap, system.lam)
        old = ca.vertcat(self._given, states, system.lam)
        new = ca.vertcat(given, a + B @ at, at)
        rows, by_state, by_lam = ca.substitute([self._gap, by_state, by_lam], [old], [new])
        scale = D[self.rows]
        return rows * scale / c, ca.diag(scale) @ (by_lam + by_state @ B) @ ca.diag(D)

    def opening_along(self, C: ca.SX) -> ca.SX:
        """What :meth:`along` needs, in the system's (x, u, p)."""
        return ca.vertcat(
            self._system.reduced.a[self._states], C[self._states, :].nz[:], self._given
        )

    def along(self, lam: ca.SX, w: ca.SX, C: ca.SX, opening: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Gaps of the rows where ``x_next = a + C w``, and their derivatives by lam and by w."""
        system, count = self._system, len(self._states)
        pattern = C[self._states, :].sparsity()
        ends = [0, count, count + pattern.nnz(), opening.numel()]
        a, entries, given = ca.vertsplit(opening, ends)
        C = ca.SX(pattern, entries)
        states = system.x_next[self._states]
        by_state, by_lam = ca.jacobian(self._gap, states), ca.jacobian(self._gap, system.lam)
        old = ca.vertcat(self._given, states, system.lam)
        new = ca.vertcat(given, a + C @ w, lam)
        rows, by_state, by_lam = ca.substitute([self._gap, by_state, by_lam], [old], [new])
        return rows, by_lam, by_state @ C
