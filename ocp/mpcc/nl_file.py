"""Contents of AMPL's .nl text files (D. M. Gay, Writing .nl files, 2005), which Pyomo and JuMP write too."""

from __future__ import annotations

import math
from collections.abc import Callable, Container
from dataclasses import dataclass, field
from functools import reduce
from operator import add, mul, neg, sub, truediv
from typing import Any

import casadi as ca

from ocp.errors import InputError

_FUNCTIONS = "tanh tan sqrt sinh sin log10 log exp cosh cos atanh atan2 atan asinh asin acosh acos"
"""CasADi's functions with the operator numbers 37 to 53."""
_UNARY: dict[int, Callable[[Any], Any]] = {
    **{37 + i: getattr(ca, name) for i, name in enumerate(_FUNCTIONS.split())},
    **{15: ca.fabs, 16: neg, 76: lambda a: a**2},
}
"""Mapping from operator numbers to functions of one argument."""
_POWERS = (5, 75, 77)
"""Operator numbers of powers: any, those with a constant base, those with a constant exponent."""
_BINARY = {0: add, 1: sub, 2: mul, 3: truediv, 48: ca.atan2, **dict.fromkeys(_POWERS, pow)}
"""Mapping from operator numbers to functions of two arguments."""
_SUMS = {11: ca.fmin, 12: ca.fmax, 54: add}
"""Mapping from numbers of operators with any number of arguments to functions that add one argument to the result."""
_ENDS = {"0": (0, 1), "1": (None, 0), "2": (0, None), "3": (None, None), "4": (0, 0)}
"""Mapping from kinds of bounds to the positions of the lower and the upper bound in a line; None where infinite."""
_HEADER_LINES = 10
"""Number of lines before the first segment."""
_TERMS_LINE = 7
"""Index of the header's line with the numbers of entries of the Jacobian and of the gradient."""
_INTEGER_LINE = 6
"""Index of the header's line with the numbers of binary and integer variables."""
_LAST_KIND = 3
"""Largest kind k in an r-line ``5 k j``: the variable has both bounds."""
_COMPLEMENTS = "5"
"""Kind of bounds in an r-line: the row is complementary to a variable."""

Line = list[str]
"""Words of one line, without its comment."""
Term = tuple[int, float]
"""Index of a variable and its coefficient."""
Ends = tuple[float, float]
"""Lower and upper bound."""


@dataclass
class NLFile:
    """Segments of an AMPL .nl file as expressions in the variables ``x`` (n, 1).

    ``bodies`` are the nonlinear parts of the rows, ``linear`` their linear parts; ``row_ends`` and
    ``x_ends`` are the bounds of rows and variables; ``complements`` maps a row to the kind k and the
    variable j (from 0) of an r-line ``5 k j``. ``defined`` maps the numbers of variables and
    of common expressions to expressions; ``options`` are the numbers of the first line. ``n_integer`` is the number
    of integer variables, which are read as real.
    """

    x: ca.SX
    n_rows: int
    options: list[int]
    n_integer: int
    defined: dict[int, Any] = field(default_factory=dict)
    bodies: dict[int, Any] = field(default_factory=dict)
    linear: dict[int, list[Term]] = field(default_factory=dict)
    objective: Any = 0.0
    gradient: list[Term] = field(default_factory=list)
    maximise: bool = False
    row_ends: list[Ends] = field(default_factory=list)
    x_ends: list[Ends] = field(default_factory=list)
    complements: dict[int, tuple[int, int]] = field(default_factory=dict)
    start: dict[int, float] = field(default_factory=dict)

    def sum_terms(self, value: Any, terms: list[Term]) -> Any:
        """Return an expression plus linear terms."""
        for index, factor in terms:
            if factor:
                value = value + factor * self.defined[index]
        return value

    def row(self, index: int) -> Any:
        """Return the expression of a row."""
        return self.sum_terms(self.bodies.get(index, 0.0), self.linear.get(index, []))


def parse_nl(text: str, name: str, names: list[str]) -> NLFile:
    """Return the contents of a file; ``names`` (n) are those of its variables, if known.

    Raises :class:`~ocp.errors.InputError` for anything but a text file of known segments and operators.
    """
    lines = [line.partition("#")[0].split() for line in text.splitlines()]
    if len(lines) < _HEADER_LINES or not lines[0] or not lines[0][0].startswith("g"):
        raise InputError(f"{name} is not an AMPL .nl text file; write it as text (in AMPL: write g{name};)")
    try:
        n, m = int(lines[1][0]), int(lines[1][1])
        options, n_integer = [int(word) for word in lines[0][1:]], sum(map(int, lines[_INTEGER_LINE]))
        n_terms = int(lines[_TERMS_LINE][0])
        if not 0 <= max(n, m) <= len(lines) or min(n, m) < 0:
            raise ValueError(f"{n} variables and {m} rows do not fit {len(lines)} lines, of which each has one")
    except (ValueError, IndexError) as error:
        raise InputError(f"{name}: the first {_HEADER_LINES} lines are no header of an .nl file: {error}") from error
    symbols = [ca.SX.sym(title) for title in names] if len(names) == n else ca.vertsplit(ca.SX.sym("x", n))
    contents = NLFile(ca.vertcat(ca.SX(0, 1), *symbols), m, options, n_integer)
    contents.defined = dict(enumerate(symbols))
    position = _HEADER_LINES
    while position < len(lines):
        try:
            position = _read_segment(contents, lines, position)
        except (ValueError, IndexError, KeyError) as error:
            reason = "a line or a word is missing" if isinstance(error, IndexError) else error.args[0]
            raise InputError(f"{name}: line {position + 1} begins no segment that can be read: {reason}") from error
    if len(contents.row_ends) < m or len(contents.x_ends) < n:
        raise InputError(f"{name} has no bounds of all rows and variables (segments r and b); is it cut off?")
    terms = sum(len(row) for row in contents.linear.values())
    if terms < n_terms:
        raise InputError(
            f"{name} has {terms} of the {n_terms} Jacobian entries of its header (segments J); is it cut off?"
        )
    return contents


def _read_segment(contents: NLFile, lines: list[Line], position: int) -> int:
    """Read the segment that begins at a line; return the line of the next one."""
    if not lines[position]:
        return position + 1
    kind, number = lines[position][0][0], lines[position][0][1:]
    first = position + 1
    # Of a segment with terms the first number is how many lines follow.
    after_terms = first + _count(lines[position][1]) if kind in "VJGS" else first
    if after_terms > len(lines):
        raise ValueError(f"the file ends after {len(lines) - first} of {after_terms - first} lines; is it cut off?")
    if kind in "CO":
        value, end = _expression(contents, lines, first)
        if kind == "C":
            contents.bodies[_index(number, contents.n_rows, "row")] = value
        elif number == "0":
            contents.objective, contents.maximise = value, bool(int(lines[position][1]))
        return end
    if kind == "V":
        terms = _terms(lines[first:after_terms], contents.defined)
        value, end = _expression(contents, lines, after_terms)
        contents.defined[int(number)] = contents.sum_terms(value, terms)
        return end
    if kind in "JG":
        terms = _terms(lines[first:after_terms], contents.defined)
        if kind == "J":
            contents.linear[_index(number, contents.n_rows, "row")] = terms
        elif number == "0":
            contents.gradient = terms
        return after_terms
    if kind == "S":
        return after_terms
    return first + _read_table(contents, lines[first:], kind, number)


def _read_table(contents: NLFile, lines: list[Line], kind: str, number: str) -> int:
    """Read bounds or starts; return their number of lines. Initial duals and column counts are skipped."""
    if kind == "r":
        for i, entries in enumerate(lines[: contents.n_rows]):
            is_pair = entries[0] == _COMPLEMENTS
            if is_pair:
                kind_of_ends = _index(entries[1], _LAST_KIND + 1, "kind of complementarity")
                contents.complements[i] = kind_of_ends, _index(entries[2], contents.x.numel(), "variable", 1) - 1
            contents.row_ends.append((-math.inf, math.inf) if is_pair else _ends(entries))
        return contents.n_rows
    if kind == "b":
        contents.x_ends = [_ends(entries) for entries in lines[: contents.x.numel()]]
        return contents.x.numel()
    if kind == "x":
        contents.start = dict(_terms(lines[: _count(number)], range(contents.x.numel())))
    elif kind not in ("d", "k"):
        raise ValueError(f"{kind + number!r} is not known")
    return _count(number)


def _count(text: str) -> int:
    """Return a number of lines; raise ValueError for a negative one."""
    if int(text) < 0:
        raise ValueError(f"the number of lines, {text}, is negative")
    return int(text)


def _index(text: str, count: int, title: str, first: int = 0) -> int:
    """Return an index from ``first`` of ``count`` items; raise ValueError for another number."""
    if not first <= int(text) < first + count:
        raise ValueError(f"{title} {text} does not exist; expected {first} to {first + count - 1}")
    return int(text)


def _terms(lines: list[Line], variables: Container[int]) -> list[Term]:
    """Return the terms that lines state; raise ValueError for an index that is not in ``variables``."""
    terms = [(int(index), float(value)) for index, value in lines]
    for index, value in terms:
        if index not in variables:
            raise ValueError(f"variable {index} does not exist")
        _finite(value, f"the number of variable {index}")
    return terms


def _finite(value: float, title: str) -> float:
    """Return a number; raise ValueError unless it is finite."""
    if not math.isfinite(value):
        raise ValueError(f"{title} is {value}, expected a finite number")
    return value


def _ends(entries: Line) -> Ends:
    """Return the lower and upper bound that a line states."""
    if entries[0] not in _ENDS:
        raise ValueError(f"bounds of type {entries[0]} are not known")
    low, high = _ENDS[entries[0]]
    return -math.inf if low is None else float(entries[1 + low]), math.inf if high is None else float(entries[1 + high])


def _expression(contents: NLFile, lines: list[Line], first: int) -> tuple[Any, int]:
    """Return the value of the prefix expression that begins at line ``first``, and the index of the line after it."""
    end = first
    while end < len(lines) and lines[end] and lines[end][0][0] in "onv0123456789":
        end += 1
    stack: list[Any] = []
    for line in reversed(lines[first:end]):
        text = line[0]
        if text[0] == "n":
            stack.append(_finite(float(text[1:]), "a constant"))
        elif text[0] == "v":
            if int(text[1:]) not in contents.defined:
                raise ValueError(f"variable {text[1:]} does not exist")
            stack.append(contents.defined[int(text[1:])])
        elif text[0] == "o":
            stack.append(_apply(int(text[1:]), stack))
        else:
            stack.append(int(text))
    if len(stack) != 1:
        raise ValueError(f"its expression leaves {len(stack)} values, expected 1; an operator is missing")
    return stack[0], end


def _apply(operator: int, stack: list[Any]) -> Any:
    """Apply an operator to arguments popped from the top of the stack, and return the result."""
    if operator in _BINARY:
        first, second = stack.pop(), stack.pop()
        return _BINARY[operator](first, second)
    if operator in _UNARY:
        return _UNARY[operator](stack.pop())
    if operator in _SUMS:
        return reduce(_SUMS[operator], [stack.pop() for _ in range(stack.pop())])
    raise ValueError(f"operator o{operator} is not known")
