"""One closed step of a system: implicit relation, explicit map, and derivatives through contact."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import casadi as ca

from dynamics.contact.elimination import solve_without_pivoting
from dynamics.contact.interior_point import lcp_solver
from dynamics.systems import ContactSystem, ParameterTable, Signal

if TYPE_CHECKING:
    from dynamics.contact.law import ContactLaw


@dataclass(frozen=True, eq=False)
class Branch:
    """One disturbance ``(x + noise_x, u + noise_u)`` at which contact is solved, and its weight."""

    weight: float
    noise_x: ca.SX
    noise_u: ca.SX


@dataclass(frozen=True, eq=False)
class Step:
    """A system whose contact is closed by a law, as expressions in (x, u, lam, p).

    With B branches (one but for averaged laws) ``lam`` has ``n = B nlam`` entries, branch after
    branch:

    ``x_next = a + B lam``, ``gap = z + F lam``, ``lam_i gap_i = mu_i``, lam, gap >= 0,

    a (nx, 1), B (nx, n), z (n, 1), F (n, n) block diagonal with blocks (nlam, nlam), mu (n, 1),
    zero for the exact law. ``p`` holds the system's parameters and then the law's knobs.

    ``residual`` (nx, 1) and ``gap`` (n, 1) are the same relation in implicit form, in
    ``(x, u, x_next, lam, p)``, for transcriptions that keep x_next and lam as unknowns.
    """

    system: ContactSystem
    law: ContactLaw
    p: ParameterTable
    lam: ca.SX
    residual: ca.SX
    gap: ca.SX
    a: ca.SX
    B: ca.SX
    z: ca.SX
    F: ca.SX
    mu: ca.SX
    branches: int

    @classmethod
    def build(cls, system: ContactSystem, law: ContactLaw, knobs: ParameterTable) -> Step:
        """Close ``system`` with ``law``; raises ``ValueError`` where the law cannot take it."""
        affine = system.affine
        nodes = law.nodes(system, knobs)
        lam = ca.SX.sym("lam", len(nodes) * system.nlam)
        a, parts, zs, Fs, mus = ca.SX.zeros(system.nx), [], [], [], []
        variables = [system.x, system.u]
        for node in nodes:
            moved = [system.x + node.noise_x, system.u + node.noise_u]
            a_i, B_i, z_i, F_i = ca.substitute(
                [affine.a, affine.B, affine.z, affine.F], variables, moved
            )
            a += node.weight * a_i
            parts.append(node.weight * B_i)
            zs.append(z_i)
            Fs.append(F_i)
            mus.append(ca.densify(law.target(system, z_i, F_i, knobs)))
        B, z, F = ca.horzcat(*parts), ca.vertcat(*zs), ca.diagcat(*Fs)
        if len(nodes) == 1:
            residual = ca.substitute(system.residual, system.lam, lam)
            gap = ca.substitute(system.gap, system.lam, lam)
        else:
            residual, gap = system.x_next - (a + B @ lam), z + F @ lam
        return cls(
            system, law, system.parameters + knobs, lam, residual, gap,
            ca.densify(a), B, ca.densify(z), F, ca.vertcat(*mus), len(nodes),
        )  # fmt: skip

    @property
    def n(self) -> int:
        """Number of contact multipliers over all branches."""
        return self.lam.numel()

    @property
    def exact(self) -> bool:
        """Whether mu is zero."""
        return self.law.exact

    @cached_property
    def contacts(self) -> tuple[Signal, ...]:
        """Names of the entries of ``lam``; branches carry their number."""
        base = self.system.contacts
        if self.branches == 1:
            return base
        return tuple(
            Signal(f"{signal.name}#{branch}", signal.unit, signal.description)
            for branch in range(self.branches)
            for signal in base
        )

    @cached_property
    def data(self) -> ca.Function:
        """Map ``(x, u, p)`` to ``(a, B, z, F, mu)``, dense but for F, block diagonal."""
        outputs = [*(ca.densify(value) for value in (self.a, self.B, self.z)), self.F,
                   ca.densify(self.mu)]  # fmt: skip
        names = ["a", "B", "z", "F", "mu"]
        return ca.Function("step_data", self._inputs, outputs, ["x", "u", "p"], names)

    @cached_property
    def relation(self) -> ca.Function:
        """Map ``(x, u, x_next, lam, p)`` to ``(residual, gap, mu)``, the implicit form, dense."""
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
        """Map ``(x, u, p)`` to ``(x_next, lam, gap, error)`` without derivatives.

        ``error`` (n, 1) is each contact's scaled violation of ``lam gap = mu``; above 1e-10 the
        path was not followed to its end.
        """
        x, u, p = self._symbols()
        a, B, z, F, mu = self.data(x, u, p)
        block = self.system.nlam
        solver = lcp_solver(block, self.exact)
        solved = []
        for branch in range(self.branches):
            rows = slice(branch * block, (branch + 1) * block)
            solved.append(solver(z[rows], F[rows, rows], mu[rows]))
        lam, gap, error = (ca.vertcat(*values) for values in zip(*solved, strict=True))
        return ca.Function(
            "step_solve",
            [x, u, p],
            [a + B @ lam, lam, gap, error],
            ["x", "u", "p"],
            ["x_next", "lam", "gap", "error"],
        )

    @cached_property
    def active_set(self) -> ca.Function:
        """Map ``(x, u, p)`` to 1 for every contact that acts (lam > gap) and 0 for the others."""
        x, u, p = self._symbols()
        _, lam, gap, _ = self.solve(x, u, p)
        return ca.Function("active_set", [x, u, p], [lam > gap], ["x", "u", "p"], ["active"])

    @cached_property
    def map(self) -> ca.Function:
        """Explicit step ``(x, u, p) -> (x_next, lam)``, differentiable to second order.

        First derivatives come from the implicit function theorem at the solution, see
        :meth:`contact_jacobian`; CasADi differentiates them again, through the solution, for exact
        Hessians (not with a law whose gradient is frozen: that one is no gradient of anything).
        """
        x, u, p = self._symbols()
        x_next, lam, _, _ = self.solve(x, u, p)
        outputs = [ca.vertcat(self.a + self.B @ self.lam), self.lam]
        inputs = self._inputs
        total = []
        for output in outputs:
            through = ca.jacobian(output, self.lam)
            for index, variable in enumerate(inputs):
                direct = ca.jacobian(output, variable)
                total.append(ca.densify(direct + through @ self._lam_jacobians[index]))
        names = ["x", "u", "p"]
        x_out = ca.SX.sym("out_x_next", self.system.nx)
        jacobian = ca.Function(
            "jac_step",
            [*inputs, x_out, self.lam],
            total,
            [*names, "out_x_next", "out_lam"],
            [f"jac_{o}_{i}" for o in ("x_next", "lam") for i in names],
        )
        options = {
            "custom_jacobian": jacobian,
            "never_inline": True,
            "enable_forward": False,
            "enable_reverse": False,
        }
        return ca.Function("step", [x, u, p], [x_next, lam], names, ["x_next", "lam"], options)

    def contact_relation(self, mu: ca.SX | None = None) -> ca.SX:
        """Return R(lam, x, u, p), (n, 1), zero at the solved contact.

        ``lam (z + F lam) - mu`` on the path; for the exact law ``D gap + (1 - D) lam`` on the
        active set ``D = lam > gap`` found at the solution.
        """
        gap = self.z + self.F @ self.lam
        if self.exact:
            active = self.lam > gap
            return active * gap + (1 - active) * self.lam
        return self.lam * gap - (self.mu if mu is None else mu)

    @cached_property
    def held(self) -> tuple[ca.SX, ca.SX] | None:
        """A symbol for mu and its value, where the law wants mu held in derivatives."""
        return (ca.SX.sym("mu_held", self.n), self.mu) if self.law.frozen else None

    @cached_property
    def differentiable_relation(self) -> ca.SX:
        """The contact relation as derivatives see it: with mu held where the law says so."""
        return self.contact_relation(self.held[0] if self.held else None)

    @cached_property
    def relation_jacobian(self) -> ca.SX:
        """``dR/dlam``: ``diag(gap) + diag(lam) F``, or ``I - D + D F`` for the exact law."""
        gap = self.z + self.F @ self.lam
        if self.exact:
            active = ca.diag(self.lam > gap)
            return ca.SX.eye(self.n) - active + active @ self.F
        return ca.diag(gap) + ca.diag(self.lam) @ self.F

    def contact_jacobian(self, variable: ca.SX) -> ca.SX:
        """``dlam/dw = -(dR/dlam)^-1 dR/dw`` at the solved lam, shape (n, w).

        On the path this is ``-(diag(gap) + diag(lam) F)^-1 (diag(lam) dgap/dw - dmu/dw)``; the
        printed abs, eq. A.26 drops the coupling between contacts. Where the law freezes mu,
        ``dmu/dw`` of the state and input is left out; its own knobs keep theirs.
        """
        own_knobs = variable is self._inputs[2]
        relation = self.contact_relation() if own_knobs else self.differentiable_relation
        partial = ca.jacobian(relation, variable)
        return -solve_without_pivoting(self.relation_jacobian, partial)

    @cached_property
    def _lam_jacobians(self) -> list[ca.SX]:
        return [self.contact_jacobian(variable) for variable in self._inputs]

    @cached_property
    def _inputs(self) -> list[ca.SX]:
        return [self.system.x, self.system.u, self.p.vector]

    def _symbols(self) -> tuple[ca.MX, ca.MX, ca.MX]:
        x, u = ca.MX.sym("x", self.system.nx), ca.MX.sym("u", self.system.nu)
        return x, u, ca.MX.sym("p", len(self.p))
