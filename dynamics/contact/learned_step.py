"""The step of a law that was learned: next states from a model, without multipliers."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca

from dynamics.contact.casadi_map import CasadiMap
from dynamics.contact.step import Step
from dynamics.systems import Signal


@dataclass(frozen=True, eq=False)
class LearnedStep(Step):
    """``x_next = sum_b w_b g(x + noise_b, u + noise_b)``, g a model; one branch without noise.

    ``inner`` are the model's outputs at the ``queries``, branch after branch; a model may have
    others after the next state (the log-density of the data). No multipliers are left: ``lam``,
    ``gap`` and ``mu`` have no entries. ``trust`` is the weight beta of ``-beta log p`` in the
    stage cost, nothing where the law has none.
    """

    learned: CasadiMap
    trust: ca.SX | None = None

    @property
    def lam(self) -> ca.SX:  # pyright: ignore[reportIncompatibleVariableOverride]
        """No multipliers, and neither gaps nor mu."""
        return ca.SX(0, 1)

    gap_expr = gap = mu = lam  # pyright: ignore[reportAssignmentType]

    @cached_property
    def contacts(self) -> tuple[Signal, ...]:
        """None."""
        return ()

    @cached_property
    def inner(self) -> ca.SX:
        """Symbols of the model's outputs (B n_out, 1)."""
        return ca.SX.sym("y", self.branches * self.learned.n_out)

    @cached_property
    def slopes(self) -> list[ca.SX]:
        """Symbols of the model's Jacobians (n_out, n_in), branch by branch."""
        shape = self.learned.n_out, self.learned.n_in
        return [ca.SX.sym(f"slope_{b}", *shape) for b in range(self.branches)]

    @cached_property
    def evaluated(self) -> ca.SX:
        """What evaluating the model gives: ``inner``, then the columns of ``slopes``."""
        return ca.vertcat(self.inner, *(ca.vec(slope) for slope in self.slopes))

    def back(self, value: ca.SX) -> ca.SX:
        """Derivative of a scalar by the queries, through ``inner`` alone, (B n_in, 1)."""
        parts = ca.vertsplit(ca.densify(ca.gradient(value, self.inner)), self.learned.n_out)
        return ca.vertcat(*(s.T @ by for s, by in zip(self.slopes, parts, strict=True)))

    @cached_property
    def queries(self) -> ca.SX:
        """Where the model is evaluated, (B n_in, 1) in (x, u, p)."""
        z = ca.vertcat(self.system.x, self.system.u)
        return ca.vertcat(*(z + ca.vertcat(b.noise_x, b.noise_u) for b in self.nodes))

    @cached_property
    def _outputs(self) -> list[ca.SX]:
        return ca.vertsplit(self.inner, self.learned.n_out)

    @cached_property
    def x_next_expr(self) -> ca.SX:
        """The branches' mean."""
        parts = zip(self.nodes, self._outputs, strict=True)
        return sum(
            (node.weight * y[: self.system.nx] for node, y in parts), ca.SX(self.system.nx, 1)
        )

    @property
    def extra_stage_cost(self) -> ca.SX:
        """``-beta log p_sigma(x, u)``, averaged over the branches."""
        if self.trust is None:
            return ca.SX(0)
        parts = zip(self.nodes, self._outputs, strict=True)
        return -self.trust * sum((node.weight * y[-1] for node, y in parts), ca.SX(0))

    @cached_property
    def residual(self) -> ca.SX:
        """``x_next - x_next_expr``, in (x_next, inner)."""
        return self.system.x_next - self.x_next_expr

    def solution(self, x: ca.MX, u: ca.MX, p: ca.MX) -> tuple[ca.MX, ...]:
        """``inner, x_next, lam, gap, error``, the last three without entries."""
        asked = ca.Function("asked", self.inputs, [ca.densify(self.queries)])(x, u, p)
        value = self.learned.values()
        inner = ca.vertcat(*(value(z) for z in ca.vertsplit(asked, self.learned.n_in)))
        x_next = ca.Function("x_next_expr", [self.inner], [ca.densify(self.x_next_expr)])(inner)
        none = ca.MX(0, 1)
        return inner, x_next, none, none, none

    @cached_property
    def relation(self) -> ca.Function:
        """``(x, u, x_next, lam, p) -> (x_next - x_next_expr, none, none)``."""
        x, u, p = self._symbols()
        after, lam, none = ca.MX.sym("x_next", self.system.nx), ca.MX.sym("lam", 0), ca.MX(0, 1)
        names = ["x", "u", "x_next", "lam", "p"], ["residual", "gap", "mu"]
        residual = after - self.solution(x, u, p)[1]
        return ca.Function("relation", [x, u, after, lam, p], [residual, none, none], *names)

    @cached_property
    def map(self) -> ca.Function:
        """``(x, u, p) -> (x_next, lam)``, differentiable to second order by the model."""
        x, u, p = self._symbols()
        _, x_next, lam, _, _ = self.solution(x, u, p)
        return ca.Function("step", [x, u, p], [x_next, lam], ["x", "u", "p"], ["x_next", "lam"])
