"""The part of a cost that no plan can change, and shares of what a plan can change."""

from __future__ import annotations

import casadi as ca
import numpy as np

_GROWING = {ca.OP_SQ: np.square, ca.OP_FABS: np.abs, ca.OP_SQRT: np.sqrt, ca.OP_COSH: np.cosh}
"""Functions that are never negative, and grow with what is not."""
_DEPTH = 200
"""Nested sums and factors that are searched for constants."""


def split_constant(cost: ca.SX, moving: ca.SX, depth: int = _DEPTH) -> tuple[ca.SX, ca.SX]:
    """Split a scalar ``cost`` into a part without constant terms, and the sum of these.

    A constant term does not depend on the symbols ``moving``. Sums, differences and products with
    constant factors are searched. The cost is returned as it is where it has none.
    """
    if not ca.depends_on(cost, moving):
        return ca.SX(0), ca.SX(cost)
    if depth == 0 or cost.is_leaf():
        return cost, ca.SX(0)
    first_operand, second_operand = cost.dep(0), cost.dep(cost.n_dep() - 1)
    first_moves, second_moves = (ca.depends_on(term, moving) for term in (first_operand, second_operand))

    def scaled(term: ca.SX, factor: ca.SX | float) -> tuple[ca.SX, ca.SX]:
        varying, constant = split_constant(term, moving, depth - 1)
        return factor * varying, factor * constant

    varying, constant = cost, ca.SX(0)
    if cost.op() in (ca.OP_ADD, ca.OP_SUB):
        sign = 1 if cost.op() == ca.OP_ADD else -1
        first, second = scaled(first_operand, 1), scaled(second_operand, sign)
        varying, constant = first[0] + second[0], first[1] + second[1]
    elif cost.op() == ca.OP_NEG:
        varying, constant = scaled(first_operand, -1)
    elif cost.op() == ca.OP_TWICE:
        varying, constant = scaled(first_operand, 2)
    elif cost.op() == ca.OP_MUL and not (first_moves and second_moves):
        varying, constant = (
            scaled(first_operand, second_operand) if first_moves else scaled(second_operand, first_operand)
        )
    elif cost.op() == ca.OP_DIV and not second_moves:
        varying, constant = scaled(first_operand, 1 / second_operand)
    return (cost, ca.SX(0)) if constant.is_zero() else (varying, constant)


def least_value(expression: ca.SX, depth: int = _DEPTH, bounds: dict[int, float] | None = None) -> float:
    """Lower bound of a scalar, as far as sums, squares and growing functions of them show one.

    Minus infinity where they do not.
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
    """Lower bound of an operation on operands with these lower bounds."""
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
