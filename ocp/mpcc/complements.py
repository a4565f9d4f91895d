"""The constraint ``complements(a, b)``, which CasADi keeps as an expression and from which a relation is read."""

from __future__ import annotations

from functools import reduce
from typing import Any

import casadi as ca
import numpy as np

from ocp.errors import InputError
from ocp.mpcc.forms import Graph, Relation

_MARKER = "complements"
"""Name of the function whose call marks a relation in a graph."""


def complements(*sides: Any, lower: Any = 0.0, upper: Any = np.inf) -> Any:
    """Return the constraint that two or more sides are complementary, entry by entry.

    - ``complements(a, b)`` is ``0 <= a ⟂ b >= 0``: both are at least zero, and one of them is zero;
    - ``complements(F, x, lower=l, upper=u)`` is ``l <= x <= u`` complementary to F (mixed
      complementarity, ``l <= x <= u ⟂ F`` in AMPL): F >= 0 where x = l, F <= 0 where x = u, and F = 0
      between; an infinite limit is none, and without both it is the equation F = 0;
    - ``complements(a, b, c)`` is ``min(a, b, c) = 0`` (vertical complementarity, Cottle and Dantzig 1970).

    Sides are SX or MX of one shape, numbers, or scalars that stand for every entry; limits are numbers or
    expressions of parameters. Use the result in ``opti.subject_to`` of a ``casadi.Opti`` that
    :func:`~ocp.mpcc.opti.opti` solves, or among the ``pairs`` of :func:`~ocp.mpcc.nlpsol.mpcc_solver`.
    The expression is the equation ``x - min(max(x - F, l), u) = 0``, which has the same solutions.

    Raises :class:`~ocp.errors.InputError` for fewer than two sides, shapes that differ, sides of which
    none is symbolic or that mix SX and MX, sides that are NaN or infinite, limits between which no number
    lies, and limits of more than two sides.
    """
    relation = relation_of_sides(sides, lower, upper)
    arguments = [*relation.sides, relation.lower, relation.upper]
    kind = type(arguments[0])
    symbols = [kind.sym(f"side_{i}", relation.size) for i in range(len(arguments))]
    residual = _residual(symbols[:-2], *symbols[-2:])
    marker = ca.Function(_MARKER, symbols, [residual], {"never_inline": True})
    return marker(*arguments) == 0


def _residual(sides: list[Any], lower: Any, upper: Any) -> Any:
    """Return an expression that is zero where the sides are complementary."""
    if len(sides) > 2:
        return reduce(ca.fmin, sides)
    a, b = sides
    return b - ca.fmin(ca.fmax(b - a, lower), upper)


def relation_of_sides(sides: Any, lower: Any = 0.0, upper: Any = np.inf) -> Relation:
    """Return the relation of two or more sides; raise :class:`~ocp.errors.InputError` as :func:`complements` does."""
    if len(sides) < 2:
        raise InputError(f"complements() takes two sides or more, got {len(sides)}; write complements(a, b)")
    kinds = {type(side) for side in sides if isinstance(side, ca.SX | ca.MX)}
    if len(kinds) != 1:
        advice = "has no symbolic side; one must be SX or MX, and a list of expressions a vertcat of them"
        raise InputError(f"complements() {'mixes SX and MX; use one of them' if kinds else advice}")
    kind: Any = kinds.pop()
    expressions = [expression_of(kind, value, "complements()") for value in (*sides, lower, upper)]
    _check_numbers(expressions)
    shapes = {value.shape for value in expressions if not value.is_scalar()}
    if len(shapes) > 1:
        listed = " and ".join(f"{rows}x{columns}" for rows, columns in sorted(shapes))
        raise InputError(f"complements() got sides or limits of {listed} entries; give all the same shape")
    if len(sides) > 2 and not (
        expressions[-2].is_zero() and expressions[-1].is_constant() and np.all(np.isinf(_numbers(expressions[-1])))
    ):
        raise InputError("complements() takes limits with two sides only; drop lower and upper, or a side")
    size = max(value.numel() for value in expressions)
    vectors = [ca.vec(value) if value.numel() == size else ca.repmat(value, size, 1) for value in expressions]
    return Relation(tuple(vectors[:-2]), *vectors[-2:])


def expression_of(kind: Any, value: Any, title: str) -> Any:
    """Return a value as a dense expression of a kind, SX or MX; raise :class:`~ocp.errors.InputError` otherwise."""
    try:
        return ca.densify(kind(value))
    except (NotImplementedError, TypeError, ValueError) as error:
        name = type(value).__name__
        raise InputError(f"{title} got a {name}; expected {kind.__name__} expressions or numbers") from error


def _check_numbers(expressions: list[Any]) -> None:
    """Raise InputError for sides, or limits at the end, that are numbers without a solution."""
    *sides, lower, upper = (_numbers(value) if value.is_constant() else np.zeros(1) for value in expressions)
    for side in sides:
        if not np.all(np.isfinite(side)):
            worst = side[~np.isfinite(side)][0]
            raise InputError(f"complements() got a side that is {worst:g}; expected finite numbers or expressions")
    are_constant = expressions[-2].is_constant() and expressions[-1].is_constant()
    is_empty = ~(lower <= upper) if are_constant else np.isnan(lower).any() | np.isnan(upper).any()
    if np.any(is_empty) or np.any(lower == np.inf) or np.any(upper == -np.inf):
        ends = " and ".join(f"{name} {end.flat[0]:g}" for name, end in (("lower", lower), ("upper", upper)))
        raise InputError(f"complements() got limits between which no number lies, {ends}; exchange or widen them")


def _numbers(constant: Graph) -> np.ndarray:
    return np.array(ca.evalf(constant))


def relation_of(expression: Graph) -> Relation | None:
    """Return the relation that an expression of :func:`complements` states; None for anything else."""
    if not isinstance(expression, ca.SX | ca.MX):
        return None
    node: Any = expression
    if isinstance(node, ca.SX):
        node = node.nz[0] if node.nnz() else node
    if node.op() == ca.OP_EQ:
        node = node.dep(0) if node.dep(0).n_dep() else node.dep(1)
    if not node.is_output() or node.dep(0).which_function().name() != _MARKER:
        return None
    call = node.dep(0)
    count = call.which_function().n_in()
    arguments = [call.dep(i) for i in range(call.n_dep())]
    if isinstance(expression, ca.SX):
        size = len(arguments) // count
        arguments = [ca.vertcat(*arguments[i * size : (i + 1) * size]) for i in range(count)]
    return Relation(tuple(arguments[:-2]), *arguments[-2:])


def scalar_graphs(symbols: list[Any], expressions: list[Any]) -> tuple[list[ca.SX], list[ca.SX]]:
    """Return symbols and expressions as SX.

    Functions that CasADi cannot expand (callbacks, interpolants, integrators) remain calls with their own
    derivatives; a graph with an operation that SX lacks, such as a linear solve, becomes one call.
    """
    if all(isinstance(symbol, ca.SX) for symbol in symbols):
        return symbols, [ca.SX(expression) for expression in expressions]
    graph = ca.Function("problem", symbols, expressions)
    scalars = [ca.SX.sym(_name(symbol), symbol.numel()) for symbol in symbols]
    shaped = [ca.reshape(s, *symbol.shape) for s, symbol in zip(scalars, symbols, strict=True)]
    try:
        return scalars, graph.call(shaped, True, False)
    except RuntimeError:
        return scalars, graph.call(shaped, False, True)


def _name(symbol: Any) -> str:
    return symbol.name() if symbol.is_symbolic() else "x"
