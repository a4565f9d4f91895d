"""The time step of a system whose contact is a linear complementarity problem with a P-matrix."""

from __future__ import annotations

from functools import cache, cached_property

import casadi as ca

from dynamics.contact.interior_point import exact_scalar_solution, repeat_until_rest, scalar_solution
from dynamics.contact.path import Path
from dynamics.contact.step import Step


class AffineStep(Step):
    """Time step ``x_next = a + B lam``, ``gap = z + F lam``, with lam alone as the inner unknown.

    a (nx, 1), B (nx, n), z (n, 1) and F (n, n), block diagonal with blocks (nlam, nlam), are expressions in
    (x, u, p). The exact law is written on the active set ``D = lam > gap``: ``D gap + (1 - D) lam = 0``.
    """

    @cached_property
    def a(self) -> ca.SX:
        """Next state x_next at lam = 0, (nx, 1)."""
        a = ca.SX.zeros(self.system.nx)
        for node in self.nodes:
            a = a + node.weight * self.at(node, [self.system.reduced.a])[0]
        return ca.densify(a)

    @cached_property
    def B(self) -> ca.SX:
        """Derivative of x_next with respect to lam, (nx, n)."""
        reduced = self.system.reduced
        return ca.horzcat(*(node.weight * self.at(node, [reduced.B])[0] for node in self.nodes))

    @cached_property
    def z(self) -> ca.SX:
        """Gaps at lam = 0, (n, 1)."""
        reduced = self.system.reduced
        return ca.densify(ca.vertcat(*(self.at(node, [reduced.z])[0] for node in self.nodes)))

    @cached_property
    def F(self) -> ca.SX:
        """Compliance: derivative of the gaps with respect to lam, (n, n)."""
        return ca.diagcat(*(self.at(node, [self.system.reduced.F])[0] for node in self.nodes))

    @cached_property
    def x_next_expr(self) -> ca.SX:
        """Next state ``a + B lam`` (nx, 1)."""
        return ca.densify(self.a + self.B @ self.lam)

    @cached_property
    def gap_expr(self) -> ca.SX:
        """Gaps ``z + F lam`` (n, 1)."""
        return ca.densify(self.z + self.F @ self.lam)

    @cached_property
    def data(self) -> ca.Function:
        """Function from ``(x, u, p)`` to ``(a, B, z, F, mu)``, all dense except the block diagonal F."""
        outputs = [*(ca.densify(value) for value in (self.a, self.B, self.z)), self.F, ca.densify(self.mu)]
        names = ["a", "B", "z", "F", "mu"]
        return ca.Function("step_data", self.inputs, outputs, ["x", "u", "p"], names)

    def solution(self, x: ca.MX, u: ca.MX, p: ca.MX) -> tuple[ca.MX, ...]:
        """Return ``lam, x_next, lam, gap, error``, solved along the path of the linear complementarity problem."""
        a, B, z, F, mu = self.data(x, u, p)
        solver = lcp_solver(self.system.nlam, self.exact)
        solved = [solver(z[rows], F[rows, rows], mu[rows]) for rows in self.rows]
        lam, gap, error = (ca.vertcat(*values) for values in zip(*solved, strict=True))
        return lam, a + B @ lam, lam, gap, error

    def contact_relation(self, mu: ca.SX | None = None) -> ca.SX:
        """Return the residual ``lam gap - mu`` (n, 1), or ``D gap + (1 - D) lam`` for the exact law."""
        if not self.exact:
            return super().contact_relation(mu)
        active = self.lam > self.gap_expr
        return active * self.gap_expr + (1 - active) * self.lam

    @cached_property
    def relation_jacobian(self) -> ca.SX:
        """Derivative of the contact relation by lam: ``diag(gap) + diag(lam) F``, or ``I - D + D F`` if exact."""
        if not self.exact:
            return ca.diag(self.gap_expr) + ca.diag(self.lam) @ self.F
        active = ca.diag(self.lam > self.gap_expr)
        return ca.SX.eye(self.n) - active + active @ self.F


@cache
def lcp_solver(n: int, exact: bool = False) -> ca.Function:
    """Return the solver ``(z, F, mu) -> (lam, s, error)`` of ``lam (z + F lam) = mu``, lam > 0.

    ``z``, ``mu``, ``lam`` (impulse), ``s`` (gap), ``error`` are (n, 1), F is a (n, n) P-matrix;
    ``error`` is each contact's scaled violation ``max(|lam s - mu|, |z + F lam - s|)``, at most
    1e-10 if the path was followed to its end, infinite if the iterates diverged because F is
    not a P-matrix. With ``exact`` mu is ignored: the solver follows the path to
    :data:`~dynamics.contact.path.MU_EXACT`, takes the contacts with lam > s as active, and solves the
    linear system on that active set, so that the complementarity is exact to rounding.

    One contact is solved in closed form. Do not differentiate this function; use the implicit
    function theorem (:mod:`dynamics.contact.step`).
    """
    z, mu, F = ca.SX.sym("z", n), ca.SX.sym("mu", n), ca.SX.sym("F", n, n)
    names = ["z", "F", "mu"], ["lam", "s", "error"]
    if n == 0:
        return ca.Function("contact_0", [z, F, mu], [z, z, z], *names)
    if n == 1:
        lam = exact_scalar_solution(z, F) if exact else scalar_solution(z, F, mu)
        s = ca.fmax(0, z) if exact else ca.if_else(z > 0, z + F * lam, mu / ca.fmax(lam, 1e-300))
        return ca.Function("contact_1", [z, F, mu], [lam, s, 0 * z], *names)
    path = Path(ca.Sparsity.dense(n, n), exact)
    opening = ca.Function("opening", [z, F, mu], [path.opening_data(z, F, mu)])
    arguments = [ca.MX.sym("z", n), ca.MX.sym("F", n, n), ca.MX.sym("mu", n)]
    data = opening(*arguments)
    pair = repeat_until_rest(path.iteration_function())(ca.MX.ones(path.size), data)
    return ca.Function(f"contact_{n}", arguments, list(path.ending_function()(pair, data)), *names)
