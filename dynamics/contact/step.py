"""One time step of a system closed by a contact law: implicit relation, explicit map, and derivatives."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property

import casadi as ca

from dynamics.contact.closure import Branch, Closure
from dynamics.systems import ContactSystem, ParameterTable, Signal
from dynamics.systems.elimination import solve_without_pivoting

# Lower limit of gaps in derivatives under the exact law.
_MIN_EXACT_GAP = 1e-60


@dataclass(frozen=True, eq=False)
class Step(ABC):
    """One time step of a system closed by a contact law, as expressions in (x, u, inner, p).

    With B branches (one except for averaged laws) ``lam`` has ``n = B nlam`` entries, branch after
    branch:

    ``x_next = x_next_expr(inner)``, ``lam_i gap_i = mu_i``, lam, gap >= 0, ``motion = 0``,

    gap and mu (n, 1), mu zero for the exact law. ``inner`` are the unknowns of the implicit function
    theorem: every branch's next state, ``states``, if they are not eliminated, followed by ``lam``.
    ``p`` contains the system's parameters, followed by the law's parameters.

    ``residual`` (nx, 1) and ``gap`` (n, 1) are the same relation in implicit form, in
    ``(x, u, x_next, lam, p)``, for transcriptions that keep x_next and lam as unknowns.
    """

    system: ContactSystem
    law: Closure
    law_parameters: ParameterTable
    nodes: tuple[Branch, ...]

    @cached_property
    def p(self) -> ParameterTable:
        """Parameters of the system, followed by those of the law."""
        return self.system.parameters + self.law_parameters

    @cached_property
    def lam(self) -> ca.SX:
        """Symbols of the contact multipliers (n, 1) of all branches."""
        return ca.SX.sym("lam", self.branches * self.system.nlam)

    @property
    def impulses(self) -> ca.SX:
        """Contact multipliers of the system (nlam, 1), the weighted mean of ``lam`` over the branches."""
        if self.branches == 1:
            return self.lam
        branches = zip(self.nodes, self.rows, strict=True)
        weighted = (node.weight * self.lam[rows] for node, rows in branches)
        return sum(weighted, ca.SX(self.system.nlam, 1))

    @cached_property
    def states(self) -> ca.SX:
        """Symbols of the next states of the branches in ``inner``, empty if lam is the only unknown."""
        return ca.SX(0, 1)

    @cached_property
    def motion(self) -> ca.SX:
        """Residual of the branches' equations of motion, one entry for each of ``states``."""
        return ca.SX(0, 1)

    @cached_property
    def states_of_lam(self) -> ca.SX:
        """Next states of the branches as expressions in (x, u, lam, p), empty if lam is the only unknown."""
        return ca.SX(0, 1)

    @cached_property
    @abstractmethod
    def x_next_expr(self) -> ca.SX:
        """Next state (nx, 1), an expression in (x, u, inner, p)."""

    @cached_property
    @abstractmethod
    def gap_expr(self) -> ca.SX:
        """Gaps (n, 1), an expression in (x, u, inner, p)."""

    @property
    def extra_stage_cost(self) -> ca.SX:
        """Term that the law adds to the stage cost, an expression in (x, u, inner, p); zero by default."""
        return ca.SX(0)

    @abstractmethod
    def solution(self, x: ca.MX, u: ca.MX, p: ca.MX) -> tuple[ca.MX, ...]:
        """Return the solved ``inner, x_next, lam, gap, error`` of all branches, without derivatives."""

    @cached_property
    def inner(self) -> ca.SX:
        """Symbols of the unknowns of the implicit function theorem, ``states`` followed by ``lam``."""
        return ca.vertcat(self.states, self.lam)

    @cached_property
    def x_next_of_lam(self) -> ca.SX:
        """Next state (nx, 1), an expression in (x, u, lam, p)."""
        return self.eliminate_states(self.x_next_expr)

    def eliminate_states(self, expression: ca.SX) -> ca.SX:
        """Return an expression with ``states_of_lam`` substituted for ``states``."""
        return ca.substitute(expression, self.states, self.states_of_lam)

    @cached_property
    def mu(self) -> ca.SX:
        """Central-path parameter of every pair (n, 1); friction and slip pairs have the mu of their normal pair."""
        return ca.vertcat(*(self._targets(node) for node in self.nodes))

    def _targets(self, node: Branch) -> ca.SX:
        system = self.system
        z, F = self.at(node, [system.reduced.z, system.reduced.F])
        deciding_pairs = sorted(set(system.deciding_pairs))
        if len(deciding_pairs) == system.nlam:
            return ca.densify(self.law.target(system, z, F, self.law_parameters))
        mu = ca.densify(
            self.law.target(system, z[deciding_pairs], F[deciding_pairs, deciding_pairs], self.law_parameters)
        )
        return ca.vertcat(*(mu[deciding_pairs.index(pair)] for pair in system.deciding_pairs))

    @cached_property
    def residual(self) -> ca.SX:
        """Residual of the equations of motion (nx, 1), an expression in (x, u, x_next, lam, p)."""
        if self.branches == 1:
            return ca.substitute(self.system.residual, self.system.lam, self.lam)
        return self.system.x_next - self.x_next_of_lam

    @cached_property
    def gap(self) -> ca.SX:
        """Gaps (n, 1), an expression in (x, u, x_next, lam, p)."""
        if self.branches == 1:
            return ca.substitute(self.system.gap, self.system.lam, self.lam)
        return self.eliminate_states(self.gap_expr)

    def at(self, node: Branch, expressions: list[ca.SX]) -> list[ca.SX]:
        """Return ``expressions`` in the system's (x, u), evaluated at the disturbed state and input of a branch."""
        system = self.system
        disturbed = [system.x + node.noise_x, system.u + node.noise_u]
        return ca.substitute(expressions, [system.x, system.u], disturbed)

    @property
    def branches(self) -> int:
        """Number of disturbances at which the contact is solved."""
        return len(self.nodes)

    @property
    def n(self) -> int:
        """Number of contact multipliers over all branches."""
        return self.lam.numel()

    @property
    def exact(self) -> bool:
        """Whether the law is exact, so that mu is zero."""
        return self.law.exact

    @cached_property
    def contacts(self) -> tuple[Signal, ...]:
        """Names and units of the entries of ``lam``; with several branches a name ends with ``#`` and a number."""
        base = self.system.contacts
        if self.branches == 1:
            return base
        return tuple(
            Signal(f"{signal.name}#{branch}", signal.unit, signal.description)
            for branch in range(self.branches)
            for signal in base
        )

    @cached_property
    def relation(self) -> ca.Function:
        """Function from ``(x, u, x_next, lam, p)`` to ``(residual, gap, mu)``: the implicit form, all outputs dense."""
        system = self.system
        return ca.Function(
            "relation",
            [system.x, system.u, system.x_next, self.lam, self.p.vector],
            [ca.densify(value) for value in (self.residual, self.gap, self.mu)],
            ["x", "u", "x_next", "lam", "p"],
            ["residual", "gap", "mu"],
        )

    @cached_property
    def solve(self) -> ca.Function:
        """Function from ``(x, u, p)`` to ``(x_next, lam, gap, error)``, without derivatives.

        ``error`` (n, 1) is each contact's scaled violation of ``lam gap = mu``: about 1e-10 or less at a solution,
        above 1e-7 if no start led to a solution.
        """
        arguments = self._symbols()
        _, *outputs = self.solution(*arguments)
        names = ["x", "u", "p"], ["x_next", "lam", "gap", "error"]
        return ca.Function("step_solve", list(arguments), outputs, *names)

    @cached_property
    def solve_inner(self) -> ca.Function:
        """Function from ``(x, u, p)`` to the solved ``inner`` unknowns, without derivatives."""
        arguments = self._symbols()
        return ca.Function("inner_solve", list(arguments), [self.solution(*arguments)[0]])

    @property
    def rows(self) -> list[slice]:
        """Slices of the rows of ``lam``, one for each branch."""
        block = self.system.nlam
        return [slice(k * block, (k + 1) * block) for k in range(self.branches)]

    @cached_property
    def map(self) -> ca.Function:
        """Explicit step ``(x, u, p) -> (x_next, lam)``, differentiable to second order.

        First derivatives come from the implicit function theorem at the solution, see :meth:`contact_jacobian`;
        CasADi differentiates them again, through the solution, for exact Hessians. A law with a frozen
        gradient has no Hessian, since a frozen gradient is not the gradient of any function.
        """
        x, u, p = self._symbols()
        x_next, lam, _, _ = self.solve(x, u, p)
        names, x_next_solved = ["x", "u", "p"], ca.SX.sym("out_x_next", self.system.nx)
        jacobians = []
        for output in (self.x_next_expr, self.lam):
            by_inner = ca.jacobian(output, self.inner)
            for index, variable in enumerate(self.inputs):
                direct = ca.jacobian(output, variable)
                jacobians.append(ca.densify(direct + by_inner @ self._inner_jacobians[index]))
        if self.states.numel():
            next_states = x_next_solved if self.branches == 1 else self.states_of_lam
            jacobians = ca.substitute(jacobians, [self.states], [next_states])
        jacobian = ca.Function(
            "jac_step",
            [*self.inputs, x_next_solved, self.lam],
            jacobians,
            [*names, "out_x_next", "out_lam"],
            [f"jac_{o}_{i}" for o in ("x_next", "lam") for i in names],
            {"cse": True},
        )
        options = {
            "custom_jacobian": jacobian,
            "never_inline": True,
            "enable_forward": False,
            "enable_reverse": False,
        }
        return ca.Function("step", [x, u, p], [x_next, lam], names, ["x_next", "lam"], options)

    def contact_relation(self, mu: ca.SX | None = None) -> ca.SX:
        """Return the residual ``lam gap - mu`` (n, 1) in (inner, x, u, p), zero at the solved contact.

        If forces may not be unique (redundant contacts, friction), the solution under the exact law is the limit of the
        central path, at which derivatives exist; inactive lam and their derivatives are zero at this limit.
        """
        return self.lam * self.gap_expr - (self.mu if mu is None else mu)

    @cached_property
    def held_mu(self) -> tuple[ca.SX, ca.SX] | None:
        """Symbol for mu and its value, if derivatives treat mu as a constant; None otherwise."""
        return (ca.SX.sym("mu_held", self.n), self.mu) if self.law.frozen else None

    @cached_property
    def differentiable_relation(self) -> ca.SX:
        """Residual that is zero at the solved ``inner``, for differentiation; mu is a symbol if the law is frozen."""
        return ca.vertcat(self.motion, self.contact_relation(self.held_mu[0] if self.held_mu else None))

    @cached_property
    def relation_jacobian(self) -> ca.SX:
        """Derivative of the relation with respect to ``inner``; it can be factorised without pivoting."""
        by_inner = ca.jacobian(self.gap_expr, self.inner)
        # The gap of an open contact's slip pair may be zero; its row is then this limit times dlam.
        gap = ca.fmax(self.gap_expr, _MIN_EXACT_GAP) if self.exact else self.gap_expr
        diagonal = ca.diag(gap) @ ca.jacobian(self.lam, self.inner)
        return ca.vertcat(ca.jacobian(self.motion, self.inner), diagonal + ca.diag(self.lam) @ by_inner)

    def solve_relation(self, rhs: ca.SX, transposed: bool = False) -> ca.SX:
        """Solve a linear system with :attr:`relation_jacobian`, or with its transpose."""
        matrix = self.relation_jacobian.T if transposed else self.relation_jacobian
        return solve_without_pivoting(matrix, rhs)

    def inner_jacobian(self, variable: ca.SX) -> ca.SX:
        """Return ``d inner/dw = -(dR/d inner)^-1 dR/dw`` at the solution, shape (n_inner, n_w).

        On the path with ``inner = lam`` this is ``-(diag(gap) + diag(lam) F)^-1 (diag(lam) dgap/dw - dmu/dw)``;
        adaptive barrier smoothing, eq. A.26, omits the coupling between contacts. If the law's gradient is frozen,
        ``dmu/dw`` is omitted for w in the state and the input, but not for parameters.
        """
        by_parameters = variable is self.inputs[2]
        relation = self.differentiable_relation
        if by_parameters:
            relation = ca.vertcat(self.motion, self.contact_relation())
        partial = ca.jacobian(relation, variable)
        return -self.solve_relation(partial)

    def contact_jacobian(self, variable: ca.SX) -> ca.SX:
        """Return ``dlam/dw`` at the solution, shape (n, n_w), see :meth:`inner_jacobian`."""
        return self.inner_jacobian(variable)[-self.n :, :]

    @cached_property
    def _inner_jacobians(self) -> list[ca.SX]:
        return [self.inner_jacobian(variable) for variable in self.inputs]

    @cached_property
    def inputs(self) -> list[ca.SX]:
        """Symbols of x, u and p."""
        return [self.system.x, self.system.u, self.p.vector]

    def _symbols(self) -> tuple[ca.MX, ca.MX, ca.MX]:
        x, u = ca.MX.sym("x", self.system.nx), ca.MX.sym("u", self.system.nu)
        return x, u, ca.MX.sym("p", len(self.p))
