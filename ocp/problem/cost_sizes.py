"""Constant part of a cost, which no plan can change; size of the remaining part; weights of a cost."""

from __future__ import annotations

from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from ocp.problem.checks import BY_PARAMETERS
from ocp.programs.units import cost_unit

if TYPE_CHECKING:
    from ocp.problem.parts import Scales
    from ocp.problem.problem import Problem

_GROWING = {ca.OP_SQ: np.square, ca.OP_FABS: np.abs, ca.OP_SQRT: np.sqrt, ca.OP_COSH: np.cosh}
"""Mapping from CasADi operations that are nonnegative and increase above zero to NumPy functions."""
_LINEAR = (ca.OP_ADD, ca.OP_SUB, ca.OP_NEG, ca.OP_TWICE, ca.OP_MUL, ca.OP_DIV)
"""CasADi operations that are searched for constant terms."""
_DEPTH = 200
"""Maximum depth of nested sums and factors that are searched for constants."""


def split_constant(cost: ca.SX, moving: ca.SX, depth: int = _DEPTH) -> tuple[ca.SX, ca.SX]:
    """Return a scalar ``cost`` without its constant terms, and the sum of the constant terms.

    A constant term does not depend on the symbols ``moving``. Sums, differences and products with
    constant factors are searched. A cost without constant terms is returned unchanged, with 0.
    """
    operation = cost.op()
    if depth == 0 or operation not in _LINEAR:
        return (cost, ca.SX(0)) if ca.depends_on(cost, moving) else (ca.SX(0), ca.SX(cost))
    first_operand, second_operand = cost.dep(0), cost.dep(cost.n_dep() - 1)

    def scaled(term: ca.SX, factor: ca.SX | float) -> tuple[ca.SX, ca.SX]:
        varying, constant = split_constant(term, moving, depth - 1)
        return factor * varying, factor * constant

    varying, constant = cost, ca.SX(0)
    if operation in (ca.OP_ADD, ca.OP_SUB):
        sign = 1 if operation == ca.OP_ADD else -1
        first, second = scaled(first_operand, 1), scaled(second_operand, sign)
        varying, constant = first[0] + second[0], first[1] + second[1]
    elif operation == ca.OP_NEG:
        varying, constant = scaled(first_operand, -1)
    elif operation == ca.OP_TWICE:
        varying, constant = scaled(first_operand, 2)
    elif not ca.depends_on(second_operand, moving):
        factor = second_operand if operation == ca.OP_MUL else 1 / second_operand
        varying, constant = scaled(first_operand, factor)
    elif operation == ca.OP_MUL and not ca.depends_on(first_operand, moving):
        varying, constant = scaled(second_operand, first_operand)
    if varying.is_zero():
        return ca.SX(0), ca.SX(cost)
    return (cost, ca.SX(0)) if constant.is_zero() else (varying, constant)


def least_value(expression: ca.SX, depth: int = _DEPTH, bounds: dict[int, float] | None = None) -> float:
    """Return a lower bound of a scalar expression, from bounds of its sums, products, squares and similar operations.

    The bound is minus infinity if none is found.
    """
    bounds = {} if bounds is None else bounds
    if expression.is_constant() or depth == 0 or expression.is_leaf():
        return float(expression) if expression.is_constant() else -np.inf
    key = expression.element_hash()
    if key not in bounds:
        operands = expression.dep(0), expression.dep(expression.n_dep() - 1)
        bounds[key] = _bound(
            expression.op(), operands[1], [least_value(operand, depth - 1, bounds) for operand in operands]
        )
    return bounds[key]


def _bound(operation: int, right: ca.SX, lower_bounds: list[float]) -> float:
    """Return a lower bound of an operation, given ``lower_bounds`` of its operands."""
    first, second = lower_bounds
    if operation in _GROWING:
        return float(_GROWING[operation](max(first, 0.0)))
    if operation == ca.OP_CONSTPOW and right.is_constant() and float(right) % 2 == 0:
        return max(first, 0.0) ** float(right) if float(right) > 0 else 0.0
    if operation in (ca.OP_ADD, ca.OP_TWICE, ca.OP_EXP):
        return float(np.exp(first)) if operation == ca.OP_EXP else first + second
    if operation == ca.OP_LOG and first > 0:
        return float(np.log(first))
    if operation in (ca.OP_MUL, ca.OP_DIV) and min(lower_bounds) >= 0:
        divisor = float(right) if right.is_constant() else np.inf
        return first * second if operation == ca.OP_MUL else first / divisor
    return -np.inf


def natural_cost_unit(problem: Problem, sizes: Scales) -> float:
    """Return the cost's unit for a solver, from its largest change as all states and inputs change by ``sizes``.

    Changes start from rest at x0. Sizes and parameter values are in natural units; the unit is a power of 2**24
    (:func:`~ocp.programs.units.cost_unit`).
    """
    units = problem.scaling.units
    p = np.array([parameter.value / units.of(parameter.unit) for parameter in problem.parameters])
    x, u = (np.array(v).ravel() for v in problem.limits(p)[:2])
    costs = [
        np.ravel(problem.cost_terms(x + s * sizes.x, u + s * sizes.u, s * sizes.u, abs(s) * sizes.impulse, p))
        for s in (0.0, -1.0, 1.0)
    ]
    changes = np.abs(np.array(costs[1:], dtype=float) - costs[0]) @ (problem.N, 1.0)
    return cost_unit(float(changes.max()) / units.cost)


def cost_weights(problem: Problem) -> set[str]:
    """Return the names of parameters that are weights: the cost is linear in each, and nothing else uses them."""
    system, cost = problem.system, ca.vertcat(problem.stage_cost, problem.terminal_cost)
    rows = (row for entry in (*problem.path, *problem.terminal) for row in (entry.expression, entry.lower, entry.upper))
    limits = [getattr(problem, field) for field in BY_PARAMETERS]
    start = [] if problem.start is None else [problem.start.lower, problem.start.upper]
    elsewhere = [system.residual, system.gap, *(ca.SX(e) for e in (*limits, *start, *rows) if e is not None)]
    other_symbols = {entry.element_hash() for expression in elsewhere for entry in ca.symvar(expression)}
    return {
        name
        for name, symbol in ((name, problem.parameters[name]) for name in problem.parameters.names)
        if symbol.element_hash() not in other_symbols
        and [any(ca.which_depends(cost, symbol, order)) for order in (1, 2)] == [True, False]
    }
