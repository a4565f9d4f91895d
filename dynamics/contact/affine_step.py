"""The step of a system whose contact is a linear complementarity problem with a P-matrix."""

from __future__ import annotations

from functools import cached_property

import casadi as ca

from dynamics.contact.interior_point import lcp_solver
from dynamics.contact.step import Step


class AffineStep(Step):
    """``x_next = a + B lam`` and ``gap = z + F lam``, with lam alone as the inner unknown.

    a (nx, 1), B (nx, n), z (n, 1), F (n, n) block diagonal with blocks (nlam, nlam), in (x, u, p).
    The exact law is on its active set ``D = lam > gap``: ``D gap + (1 - D) lam = 0``.
    """

    @cached_property
    def a(self) -> ca.SX:
        """x_next at lam = 0, (nx, 1)."""
        a = ca.SX.zeros(self.system.nx)
        for node in self.nodes:
            a = a + node.weight * self.at(node, [self.system.reduced.a])[0]
        return ca.densify(a)

    @cached_property
    def B(self) -> ca.SX:
        """Derivative of x_next by lam, (nx, n)."""
        reduced = self.system.reduced
        return ca.horzcat(*(node.weight * self.at(node, [reduced.B])[0] for node in self.nodes))

    @cached_property
    def z(self) -> ca.SX:
        """The gaps at lam = 0, (n, 1)."""
        reduced = self.system.reduced
        return ca.densify(ca.vertcat(*(self.at(node, [reduced.z])[0] for node in self.nodes)))

    @cached_property
    def F(self) -> ca.SX:
        """Derivative of the gaps by lam, (n, n)."""
        return ca.diagcat(*(self.at(node, [self.system.reduced.F])[0] for node in self.nodes))

    @cached_property
    def x_next_expr(self) -> ca.SX:
        """``a + B lam``."""
        return ca.densify(self.a + self.B @ self.lam)

    @cached_property
    def gap_expr(self) -> ca.SX:
        """``z + F lam``."""
        return ca.densify(self.z + self.F @ self.lam)

    @cached_property
    def data(self) -> ca.Function:
        """Map ``(x, u, p)`` to ``(a, B, z, F, mu)``, dense but for F, block diagonal."""
        outputs = [*(ca.densify(value) for value in (self.a, self.B, self.z)), self.F,
                   ca.densify(self.mu)]  # fmt: skip
        names = ["a", "B", "z", "F", "mu"]
        return ca.Function("step_data", self.inputs, outputs, ["x", "u", "p"], names)

    def solution(self, x: ca.MX, u: ca.MX, p: ca.MX) -> tuple[ca.MX, ...]:
        """``lam, x_next, lam, gap, error`` by the path of the linear problem."""
        a, B, z, F, mu = self.data(x, u, p)
        solver = lcp_solver(self.system.nlam, self.exact)
        solved = [solver(z[rows], F[rows, rows], mu[rows]) for rows in self.rows]
        lam, gap, error = (ca.vertcat(*values) for values in zip(*solved, strict=True))
        return lam, a + B @ lam, lam, gap, error

    def contact_relation(self, mu: ca.SX | None = None) -> ca.SX:
        """``lam gap - mu``, or ``D gap + (1 - D) lam`` for the exact law."""
        if not self.exact:
            return super().contact_relation(mu)
        active = self.lam > self.gap_expr
        return active * self.gap_expr + (1 - active) * self.lam

    @cached_property
    def relation_jacobian(self) -> ca.SX:
        """``diag(gap) + diag(lam) F``, or ``I - D + D F`` for the exact law."""
        if not self.exact:
            return ca.diag(self.gap_expr) + ca.diag(self.lam) @ self.F
        active = ca.diag(self.lam > self.gap_expr)
        return ca.SX.eye(self.n) - active + active @ self.F
