"""Unknowns of a stage that its variables determine, and derivatives through these unknowns."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import casadi as ca

from dynamics.contact.learned_step import LearnedStep
from dynamics.systems.elimination import solve_without_pivoting

Compile = Callable[[ca.Function], ca.Function]


class EliminatedUnknowns(ABC):
    """Unknowns ``inner`` (n,) that the local variables w of a stage determine.

    The argument ``symbols`` of the stage's functions contains ``inner`` and further values that derivatives need. The
    function :attr:`solve` computes these values, ``(w, p) -> symbols``.
    """

    inner: ca.SX
    symbols: ca.SX
    solve: ca.Function

    def values(self, w: ca.MX, p: ca.MX, copies: int) -> ca.MX:
        """Return values (n, copies) of ``symbols`` at the local variables ``w`` (nw, copies)."""
        return self.solve.map("solve_map", "serial", copies, [1], [])(w, p)

    @abstractmethod
    def sensitivity(self, w: ca.SX) -> ca.SX:
        """Return ``d inner / dw`` (n, nw)."""

    @abstractmethod
    def total_hessian(self, lagrangian: ca.SX, w: ca.SX) -> ca.SX:
        """Return the second total derivative (nw, nw) of ``lagrangian``, an expression in w and ``inner``."""

    def substitute_held(self, outputs: list[ca.SX]) -> list[ca.SX]:
        """Return derivatives of a stage with symbols that were held constant replaced by their values."""
        return outputs

    @property
    def curvatures(self) -> ca.SX:
        """Symbols of second derivatives that are evaluated numerically, empty by default."""
        return ca.SX(0, 1)

    def curvature_values(self, slope: ca.Function, arguments: list[ca.MX], copies: int) -> list[ca.MX]:
        """Return values of ``curvatures`` (., copies); ``slope`` maps ``arguments`` to ``dL/d inner``."""
        return []


@dataclass(eq=False)
class Implicit(EliminatedUnknowns):
    """Unknowns that solve ``relation(inner, w, p) = 0``; ``held`` is None, or a symbol in the relation and its value.

    All derivatives come from the implicit function theorem, with the held symbol as a constant.
    """

    inner: ca.SX
    relation: ca.SX
    relation_jacobian: ca.SX
    solve: ca.Function
    held: tuple[ca.SX, ca.SX] | None = None

    def __post_init__(self) -> None:
        self.symbols = self.inner

    def sensitivity(self, w: ca.SX) -> ca.SX:
        """Return ``-(dR/d inner)^-1 dR/dw`` (n, nw), with R the relation."""
        return -solve_without_pivoting(self.relation_jacobian, ca.jacobian(self.relation, w))

    def total_hessian(self, lagrangian: ca.SX, w: ca.SX) -> ca.SX:
        """Return ``[I; Y]' grad²(L + a' R) [I; Y]``, with Y the sensitivity and ``R_y' a = -dL/dy``, y = ``inner``."""
        slope = ca.gradient(lagrangian, self.inner)
        solved = -solve_without_pivoting(self.relation_jacobian.T, ca.densify(slope))
        adjoint = ca.SX.sym("adjoint", self.inner.numel())
        all_symbols = ca.vertcat(w, self.inner)
        curved = ca.hessian(lagrangian + ca.dot(adjoint, self.relation), all_symbols)[0]
        curved = ca.substitute(curved, adjoint, solved)
        basis = ca.vertcat(ca.SX.eye(w.numel()), self.sensitivity(w))
        return basis.T @ curved @ basis

    def substitute_held(self, outputs: list[ca.SX]) -> list[ca.SX]:
        """Return the outputs with the held symbol replaced by its value."""
        return outputs if self.held is None else ca.substitute(outputs, *([s] for s in self.held))


@dataclass(eq=False)
class ModelOutputs(EliminatedUnknowns):
    """Outputs of a learned step's model at ``queries``, which are expressions in w and p.

    The model's Jacobians are evaluated together with its values; its second derivatives are contracted
    with the gradient of the Lagrangian.
    """

    step: LearnedStep
    queries: ca.SX
    w: ca.SX
    p: ca.SX

    def __post_init__(self) -> None:
        self.map, self.inner, self.symbols = (self.step.learned, self.step.inner, self.step.model_outputs)
        self.curvature_symbols = [ca.SX.sym("curvature", self.map.n_in, self.map.n_in) for _ in self.step.nodes]
        self.query_function = ca.Function("queries", [self.w, self.p], [ca.densify(self.queries)])
        w, p = ca.MX.sym("w", self.w.numel()), ca.MX.sym("p", self.p.numel())
        self.solve = ca.Function("evaluate", [w, p], [self.values(w, p, 1)], ["w", "p"], ["y"])

    def _queries(self, w: ca.MX, p: ca.MX, copies: int) -> ca.MX:
        query_values = self.query_function.map("queries_map", "serial", copies, [1], [])(w, p)
        return ca.reshape(query_values, self.map.n_in, -1)

    def values(self, w: ca.MX, p: ca.MX, copies: int) -> ca.MX:
        """Return values of ``symbols`` for all copies, evaluated in one batch."""
        y, jacobians = self.map.jacobian_function(len(self.curvature_symbols) * copies)(self._queries(w, p, copies))
        return ca.vertcat(ca.reshape(y, -1, copies), ca.reshape(jacobians, -1, copies))

    @cached_property
    def _by_w(self) -> list[ca.SX]:
        return ca.vertsplit(ca.jacobian(self.queries, self.w), self.map.n_in)

    def sensitivity(self, w: ca.SX) -> ca.SX:
        """Return ``g'(z_b) dz_b/dw`` of all branches b, stacked."""
        branch_jacobians = zip(self.step.jacobians, self._by_w, strict=True)
        return ca.vertcat(*(J @ by_w for J, by_w in branch_jacobians))

    def total_hessian(self, lagrangian: ca.SX, w: ca.SX) -> ca.SX:
        """Return ``[I; Y]' grad² L [I; Y] + sum_b (dz_b/dw)' H_b dz_b/dw + grad²(a' z)``.

        H_b is the model's second derivative contracted with dL/dinner. a is dL/dinner times the
        model's Jacobian, held constant; the last term vanishes if the queries z are affine in w.
        """
        basis = ca.vertcat(ca.SX.eye(w.numel()), self.sensitivity(w))
        total = basis.T @ ca.hessian(lagrangian, ca.vertcat(w, self.inner))[0] @ basis
        for curvature, by_w in zip(self.curvature_symbols, self._by_w, strict=True):
            total += by_w.T @ curvature @ by_w
        weights = ca.SX.sym("held", self.queries.numel())
        query_hessian = ca.hessian(ca.dot(weights, self.queries), w)[0]
        return total + ca.substitute(query_hessian, weights, self.step.query_gradient(lagrangian))

    @property
    def curvatures(self) -> ca.SX:
        """Symbols of the entries of all H_b, see :meth:`total_hessian`."""
        return ca.vertcat(*(ca.vec(curvature) for curvature in self.curvature_symbols))

    def curvature_values(self, slope: ca.Function, arguments: list[ca.MX], copies: int) -> list[ca.MX]:
        """Return values of the H_b of :meth:`total_hessian` for all copies, evaluated in one batch."""
        weights = slope.map("weights", "serial", copies, [1], [])(*arguments)
        queries = self._queries(arguments[0], arguments[1], copies)
        curvature_function = self.map.curvature_function(queries.shape[1])
        curvatures = curvature_function(queries, ca.reshape(weights, self.map.n_out, -1))
        return [ca.reshape(curvatures, -1, copies)]
