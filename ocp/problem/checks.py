"""Checks of a problem: the symbols of its expressions, its physics, and guesses."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from ocp.errors import InputError, abbreviated

if TYPE_CHECKING:
    from ocp.problem.problem import Problem

BY_PARAMETERS = ("x0", "u_before", "u_lower", "u_upper", "x_lower", "x_upper")
"""Names of a problem's fields that are expressions in its parameters only."""


def check_symbols(label: str, value: ca.SX, known_symbols: Iterable[ca.SX], expected: str) -> None:
    """Raise :class:`~ocp.errors.InputError` if ``value`` uses a symbol that is not in ``known_symbols``.

    The message says that the symbol is ``expected``, such as "no declared parameter".
    """
    declared = {symbol.element_hash() for symbols in known_symbols for symbol in ca.symvar(symbols)}
    used_symbols = ca.symvar(value)
    unknown_names = sorted({str(symbol) for symbol in used_symbols if symbol.element_hash() not in declared})
    if unknown_names:
        raise InputError(f"{label} uses {', '.join(unknown_names)}, which is {expected}")


def check_problem_symbols(problem: Problem) -> None:
    """Raise :class:`~ocp.errors.InputError` if a field of a problem uses a symbol that it may not depend on."""
    name, s, free = problem.name, problem.system, problem.start
    if problem.du is not None and not problem.du.is_valid_input():
        raise InputError(f"{name}: du must be symbols, ca.SX.sym('du', {s.nu})")
    p = problem.parameters.vector
    stage_symbols = [s.x, p, s.u, s.lam, *([] if problem.du is None else [problem.du])]
    bounds = [
        (f"{side} of {row.name}", getattr(row, side))
        for row in (*problem.path, *problem.terminal)
        for side in ("lower", "upper")
    ]
    bounds += [] if free is None else [("the start", free.lower), ("the start", free.upper)]
    at_end = [("terminal_cost", problem.terminal_cost), *((row.name, row.expression) for row in problem.terminal)]
    by_parameters = [*((field, getattr(problem, field)) for field in BY_PARAMETERS), *bounds]
    in_stage = "contact impulse or declared parameter"
    foreign = "no parameter of the problem; give the problem the table that the system has"
    for known_symbols, expressions, expected in (
        (stage_symbols, [("stage_cost", problem.stage_cost)], f"no state, input, du, {in_stage}"),
        (
            [*stage_symbols, s.x_next],
            [(row.name, row.expression) for row in problem.path],
            f"no state, input, next state, {in_stage}",
        ),
        ([s.x, p], at_end, "no state or declared parameter"),
        ([p], by_parameters, "no declared parameter"),
        ([p], [("the system", s.parameters.vector)], foreign),
    ):
        for field, expression in expressions:
            if expression is not None:
                check_symbols(f"{name}: {field}", expression, known_symbols, expected)


def check_physics(problem: Problem, values: Mapping[str, float] | None = None) -> None:
    """Check step size, mass, stiffness and friction at x0, if they are known.

    ``values`` is a dict from parameters to values, by default the declared values. Raises
    :class:`~ocp.errors.InputError` unless h > 0, M and K are positive definite and no coefficient of friction is
    negative.
    """
    name = problem.name
    p = problem.parameters.values if values is None else problem.parameters.pack(values)
    h, M, K, friction = (np.array(entries) for entries in problem.physics(problem.limits(p)[0], p))
    if not h > 0:
        raise InputError(f"{name}: the step size must be positive, got {h.item():g} s")
    for matrix, matrix_name, remedy in ((M, "mass", "masses and inertias"), (K, "stiffness", "stiffnesses")):
        is_finite = np.isfinite(matrix).all()
        smallest_eigenvalue = np.linalg.eigvalsh(matrix).min(initial=np.inf) if is_finite else np.nan
        if not smallest_eigenvalue > 0:
            raise InputError(
                f"{name}: the {matrix_name} matrix must be positive definite, but its smallest"
                f" eigenvalue is {smallest_eigenvalue:g}; raise the {remedy} above zero"
            )
    if not np.all(friction >= 0):
        raise InputError(f"{name}: Coulomb's coefficients of friction must not be negative, got {friction.min():g}")


def check_guess(problem: Problem, guess: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return a guess as arrays of states (N+1, nx) and inputs (N, nu).

    Raises :class:`~ocp.errors.InputError` for other shapes, or values that are not finite.
    """
    name = problem.name
    try:
        states, inputs = (np.asarray(array) for array in guess)
    except (TypeError, ValueError):
        raise InputError(f"{name}: the guess must be two arrays, states and inputs, got {abbreviated(guess)}") from None
    shapes = states.shape, inputs.shape
    expected = (problem.N + 1, problem.system.nx), (problem.N, problem.system.nu)
    if shapes != expected:
        raise InputError(
            f"{name}: the guess has states {shapes[0]} and inputs {shapes[1]}, expected {expected[0]} and {expected[1]}"
        )
    if not all(array.dtype.kind in "if" and np.isfinite(array).all() for array in (states, inputs)):
        raise InputError(f"{name}: the guess must be finite")
    return states, inputs
