"""The time step of a system with friction, curved gaps or redundant contacts."""

from __future__ import annotations

from functools import cached_property

import casadi as ca

from dynamics.contact.ncp import ncp_solver
from dynamics.contact.step import Step
from dynamics.systems.elimination import solve_in_order

# Steps of iterative refinement; each gains three or four digits at the end of the path, where pivots are
# of the size of mu.
_REFINEMENTS = 2


class ImplicitStep(Step):
    """Time step whose unknowns are lam and the next states of all branches, ``inner = (states, lam)``.

    Residual and gap are differentiated without substituting ``x_next = a + B lam``, which would enlarge
    their graphs. The solution under the exact law is the end of the central path.
    """

    @cached_property
    def states(self) -> ca.SX:
        """Symbols of the next states of the B branches, one after the other (B nx, 1)."""
        return ca.SX.sym("x_branch", self.branches * self.system.nx)

    @cached_property
    def x_next_expr(self) -> ca.SX:
        """Weighted mean of the branches' next states (nx, 1)."""
        mean = ca.SX.zeros(self.system.nx)
        for node, state in zip(self.nodes, ca.vertsplit(self.states, self.system.nx), strict=True):
            mean = mean + node.weight * state
        return mean

    @cached_property
    def gap_expr(self) -> ca.SX:
        """Gaps (n, 1) of all branches, each at its next state."""
        return self._of_branches(self.system.gap)

    @cached_property
    def motion(self) -> ca.SX:
        """Residual (B nx, 1) of the equations of motion of all branches, each at its next state."""
        return self._of_branches(self.system.motion)

    @cached_property
    def states_of_lam(self) -> ca.SX:
        """Next states (B nx, 1) of all branches as expressions in (x, u, lam, p)."""
        return self._of_branches(self.system.x_next_expr)

    def _of_branches(self, expression: ca.SX) -> ca.SX:
        system, values = self.system, []
        states = ca.vertsplit(self.states, system.nx)
        for node, state, rows in zip(self.nodes, states, self.rows, strict=True):
            disturbed = self.at(node, [expression])
            values += ca.substitute(disturbed, [system.x_next, system.lam], [state, self.lam[rows]])
        return ca.densify(ca.vertcat(*values))

    def solve_relation(self, rhs: ca.SX, transposed: bool = False) -> ca.SX:
        """Solve a linear system with :attr:`relation_jacobian`, or with its transpose.

        If the inertia depends on the state, lam is eliminated before the coordinates that impulses act on;
        the remaining system then has only as many unknowns as there are such coordinates.
        """
        if not self.system.has_variable_inertia:
            return super().solve_relation(rhs, transposed)
        system = self.system
        by_lam = ca.jacobian(system.residual, system.lam)
        pushed_rows = set(by_lam.sparsity().get_triplet()[0])
        pushed = {b * system.nx + i for b in range(self.branches) for i in pushed_rows}
        order = [i for i in range(self.inner.numel()) if i not in pushed] + sorted(pushed)
        matrix = self.relation_jacobian.T if transposed else self.relation_jacobian
        return solve_in_order(ca.sparsify(matrix), rhs, order, _REFINEMENTS)

    def solution(self, x: ca.MX, u: ca.MX, p: ca.MX) -> tuple[ca.MX, ...]:
        """Return ``inner, x_next, lam, gap, error``, solved along the path of the nonlinear problem."""
        noise = ca.Function(
            "noise",
            [self.p.vector],
            [
                ca.horzcat(*(ca.densify(disturbance) for disturbance in disturbances))
                for disturbances in zip(*((node.noise_x, node.noise_u) for node in self.nodes), strict=True)
            ],
        )
        by_x, by_u = noise(p)
        mu = ca.Function("targets", self.inputs, [ca.densify(self.mu)])(x, u, p)
        solver, physical = ncp_solver(self.system, self.exact), p[: len(self.system.parameters)]
        solved = [solver(x + by_x[:, k], u + by_u[:, k], physical, mu[rows]) for k, rows in enumerate(self.rows)]
        states = [branch[0] for branch in solved]
        lam, gap, error = (ca.vertcat(*(branch[i] for branch in solved)) for i in (1, 2, 3))
        x_next = ca.MX.zeros(self.system.nx)
        for node, state in zip(self.nodes, states, strict=True):
            x_next += node.weight * state
        return ca.vertcat(*states, lam), x_next, lam, gap, error
