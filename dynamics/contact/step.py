"""One closed step of a system: implicit relation, explicit map, and derivatives through contact."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import casadi as ca

from dynamics.contact.interior_point import lcp_solver
from dynamics.contact.ncp import ncp_solver
from dynamics.systems import ContactSystem, ParameterTable, Signal
from dynamics.systems.elimination import solve_without_pivoting

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
    """A system whose contact is closed by a law, as expressions in (x, u, inner, p).

    With B branches (one but for averaged laws) ``lam`` has ``n = B nlam`` entries, branch after
    branch:

    ``x_next = a + B lam``, ``lam_i slack_i = mu_i``, lam, slack >= 0,

    a (nx, 1), B (nx, n), slack (n, 1) the gaps, mu (n, 1), zero for the exact law. Near ``lam = 0``
    ``slack = z + F lam``, z (n, 1), F (n, n) block diagonal with blocks (nlam, nlam); everywhere
    where the gaps are affine. ``p`` holds the system's parameters and then the law's knobs.

    ``inner`` are the unknowns that derivatives go through: ``lam``, or every branch's next state
    and then ``lam`` where the system is implicit; ``following`` (nx, 1) is x_next in terms of them.

    ``residual`` (nx, 1) and ``gap`` (n, 1) are the same relation in implicit form, in
    ``(x, u, x_next, lam, p)``, for transcriptions that keep x_next and lam as unknowns. ``motion``
    is the residual of every branch in terms of ``inner``, and ``landing`` the branches' next states
    in terms of ``lam``.
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
    nodes: tuple[Branch, ...]
    inner: ca.SX
    following: ca.SX
    slack: ca.SX
    motion: ca.SX
    landing: ca.SX

    @classmethod
    def build(cls, system: ContactSystem, law: ContactLaw, knobs: ParameterTable) -> Step:
        """Close ``system`` with ``law``; raises ``ValueError`` where the law cannot take it."""
        nodes = tuple(law.nodes(system, knobs))
        count, nx, nlam = len(nodes), system.nx, system.nlam
        reduced, lam = system.reduced, ca.SX.sym("lam", len(nodes) * nlam)
        states = ca.SX.sym("x_branch", nx, count)
        variables, unknown = [system.x, system.u], [system.x_next, system.lam]
        a, following = ca.SX.zeros(nx), ca.SX.zeros(nx)
        parts, zs, Fs, mus, slacks, motions, landings = [], [], [], [], [], [], []
        explicits = []
        for k, node in enumerate(nodes):
            moved = [system.x + node.noise_x, system.u + node.noise_u]
            a_k, B_k, z_k, F_k, gap, residual = ca.substitute(
                [reduced.a, reduced.B, reduced.z, reduced.F, system.gap, system.residual],
                variables, moved,
            )  # fmt: skip
            own = lam[k * nlam : (k + 1) * nlam]
            landing = ca.densify(a_k + B_k @ own)
            x_k = states[:, k] if system.implicit else landing
            explicit = z_k + F_k @ own
            if not reduced.affine:
                explicit = ca.substitute(gap, ca.vertcat(*unknown), ca.vertcat(landing, own))
            landings.append(landing)
            explicits.append(explicit)
            gap, residual = ca.substitute([gap, residual], unknown, [x_k, own])
            a, following = a + node.weight * a_k, following + node.weight * x_k
            parts.append(node.weight * B_k)
            zs.append(z_k)
            Fs.append(F_k)
            mus.append(_targets(system, law, z_k, F_k, knobs))
            slacks.append(gap if system.implicit else explicit)
            motions.append(residual)
        B, z, F = ca.horzcat(*parts), ca.vertcat(*zs), ca.diagcat(*Fs)
        slack = ca.vertcat(ca.SX(0, 1), *slacks)
        if count == 1:
            residual = ca.substitute(system.residual, system.lam, lam)
            gap = ca.substitute(system.gap, system.lam, lam)
        else:
            residual, gap = system.x_next - (a + B @ lam), ca.vertcat(*explicits)
        inner = ca.vertcat(ca.vec(states), lam) if system.implicit else lam
        motion = ca.vertcat(*motions) if system.implicit else ca.SX(0, 1)
        return cls(
            system, law, system.parameters + knobs, lam, residual, gap, ca.densify(a), B,
            ca.densify(z), F, ca.vertcat(*mus), nodes, inner, ca.densify(following),
            ca.densify(slack), motion, ca.vertcat(ca.SX(0, 1), *landings),
        )  # fmt: skip

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

        ``error`` (n, 1) is each contact's scaled violation of ``lam gap = mu``; above 1e-7 the step
        was not solved, from whatever start, and below 1e-10 but for rounding it was.
        """
        arguments = self._symbols()
        _, *outputs = self._solution(*arguments)
        names = ["x", "u", "p"], ["x_next", "lam", "gap", "error"]
        return ca.Function("step_solve", list(arguments), outputs, *names)

    @cached_property
    def solve_inner(self) -> ca.Function:
        """Map ``(x, u, p)`` to the solved ``inner`` unknowns, without derivatives."""
        arguments = self._symbols()
        return ca.Function("inner_solve", list(arguments), [self._solution(*arguments)[0]])

    def _solution(self, x: ca.MX, u: ca.MX, p: ca.MX) -> tuple[ca.MX, ...]:
        """Solve every branch: ``inner, x_next, lam, gap, error``."""
        if not self.linear:
            return self._solution_by_path(x, u, p)
        a, B, z, F, mu = self.data(x, u, p)
        solver = lcp_solver(self.system.nlam, self.exact)
        solved = [solver(z[row], F[row, row], mu[row]) for row in self._rows()]
        lam, gap, error = (ca.vertcat(*values) for values in zip(*solved, strict=True))
        return lam, a + B @ lam, lam, gap, error

    def _solution_by_path(self, x: ca.MX, u: ca.MX, p: ca.MX) -> tuple[ca.MX, ...]:
        noise = ca.Function("noise", [self.p.vector], [
            ca.horzcat(*(ca.densify(part) for part in parts))
            for parts in zip(*((node.noise_x, node.noise_u) for node in self.nodes), strict=True)
        ])  # fmt: skip
        by_x, by_u = noise(p)
        mu = ca.Function("targets", self._inputs, [ca.densify(self.mu)])(x, u, p)
        solver, physical = ncp_solver(self.system, self.exact), p[: len(self.system.parameters)]
        solved = [
            solver(x + by_x[:, k], u + by_u[:, k], physical, mu[row])
            for k, row in enumerate(self._rows())
        ]
        states = [branch[0] for branch in solved]
        lam, gap, error = (ca.vertcat(*(branch[i] for branch in solved)) for i in (1, 2, 3))
        x_next = ca.MX.zeros(self.system.nx)
        for node, state in zip(self.nodes, states, strict=True):
            x_next += node.weight * state
        return (ca.vertcat(*states, lam) if self.system.implicit else lam), x_next, lam, gap, error

    def _rows(self) -> list[slice]:
        """Rows of ``lam`` of every branch."""
        block = self.system.nlam
        return [slice(k * block, (k + 1) * block) for k in range(self.branches)]

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
        names, out = ["x", "u", "p"], ca.SX.sym("out_x_next", self.system.nx)
        total = []
        for output in (self.following, self.lam):
            through = ca.jacobian(output, self.inner)
            for index, variable in enumerate(self._inputs):
                direct = ca.jacobian(output, variable)
                total.append(ca.densify(direct + through @ self._inner_jacobians[index]))
        if self.system.implicit:
            states = self.inner[: self.branches * self.system.nx]
            total = ca.substitute(total, [states], [out if self.branches == 1 else self.landing])
        jacobian = ca.Function(
            "jac_step",
            [*self._inputs, out, self.lam],
            total,
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

    @property
    def linear(self) -> bool:
        """Whether the contact is a linear complementarity problem with a P-matrix."""
        system = self.system
        return system.reduced.affine and not (system.implicit or system.redundant)

    def contact_relation(self, mu: ca.SX | None = None) -> ca.SX:
        """Return R(lam, x, u, p), (n, 1), zero at the solved contact.

        ``lam slack - mu`` on the path; for the exact law of a linear problem
        ``D slack + (1 - D) lam`` on the active set ``D = lam > slack`` found at the solution. Where
        forces may be open (redundant contacts, friction) the exact law is the path's end, whose
        derivative exists.
        """
        if self.exact and self.linear:
            active = self.lam > self.slack
            return active * self.slack + (1 - active) * self.lam
        return self.lam * self.slack - (self.mu if mu is None else mu)

    @cached_property
    def held(self) -> tuple[ca.SX, ca.SX] | None:
        """A symbol for mu and its value, where the law wants mu held in derivatives."""
        return (ca.SX.sym("mu_held", self.n), self.mu) if self.law.frozen else None

    @cached_property
    def differentiable_relation(self) -> ca.SX:
        """What ``inner`` solves, as derivatives see it: with mu held where the law says so."""
        return ca.vertcat(self.motion, self.contact_relation(self.held[0] if self.held else None))

    @cached_property
    def relation_jacobian(self) -> ca.SX:
        """Derivative of the relation by ``inner``; no elimination in it needs pivoting.

        For ``inner = lam``: ``diag(slack) + diag(lam) F``, or ``I - D + D F`` for the exact law.
        """
        if self.exact and self.linear:
            active = ca.diag(self.lam > self.slack)
            return ca.SX.eye(self.n) - active + active @ self.F
        by_inner = ca.jacobian(self.slack, self.inner)
        diagonal = ca.diag(self.slack) @ ca.jacobian(self.lam, self.inner)
        return ca.vertcat(
            ca.jacobian(self.motion, self.inner), diagonal + ca.diag(self.lam) @ by_inner
        )

    def inner_jacobian(self, variable: ca.SX) -> ca.SX:
        """``d inner/dw = -(dR/d inner)^-1 dR/dw`` at the solution, shape (n_inner, w).

        On the path with ``inner = lam`` this is ``-(diag(slack) + diag(lam) F)^-1 (diag(lam)
        dgap/dw - dmu/dw)``; the printed abs, eq. A.26 drops the coupling between contacts. Where
        the law freezes mu, ``dmu/dw`` of the state and input is left out; its own knobs keep
        theirs.
        """
        own_knobs = variable is self._inputs[2]
        relation = self.differentiable_relation
        if own_knobs:
            relation = ca.vertcat(self.motion, self.contact_relation())
        partial = ca.jacobian(relation, variable)
        return -solve_without_pivoting(self.relation_jacobian, partial)

    def contact_jacobian(self, variable: ca.SX) -> ca.SX:
        """``dlam/dw`` at the solution, shape (n, w), see :meth:`inner_jacobian`."""
        return self.inner_jacobian(variable)[-self.n :, :]

    @cached_property
    def _inner_jacobians(self) -> list[ca.SX]:
        return [self.inner_jacobian(variable) for variable in self._inputs]

    @cached_property
    def _inputs(self) -> list[ca.SX]:
        return [self.system.x, self.system.u, self.p.vector]

    def _symbols(self) -> tuple[ca.MX, ca.MX, ca.MX]:
        x, u = ca.MX.sym("x", self.system.nx), ca.MX.sym("u", self.system.nu)
        return x, u, ca.MX.sym("p", len(self.p))


def _targets(
    system: ContactSystem, law: ContactLaw, z: ca.SX, F: ca.SX, knobs: ParameterTable
) -> ca.SX:
    """mu of every pair: the law's for those that decide, and the same for those that go along."""
    chosen = sorted(set(system.deciding))
    if len(chosen) == system.nlam:
        return ca.densify(law.target(system, z, F, knobs))
    mu = ca.densify(law.target(system, z[chosen], F[chosen, chosen], knobs))
    return ca.vertcat(*(mu[chosen.index(pair)] for pair in system.deciding))
