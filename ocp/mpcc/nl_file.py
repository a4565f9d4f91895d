"""Contents of AMPL's .nl text files (D. M. Gay, Writing .nl files, 2005), which Pyomo and JuMP write too."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import casadi as ca

from ocp.errors import InputError

_UNARY: dict[int, Callable[[Any], Any]] = {
    15: ca.fabs,
    16: lambda a: -a,
    37: ca.tanh,
    38: ca.tan,
    39: ca.sqrt,
    40: ca.sinh,
    41: ca.sin,
    42: ca.log10,
    43: ca.log,
    44: ca.exp,
    45: ca.cosh,
    46: ca.cos,
    47: ca.atanh,
    49: ca.atan,
    50: ca.asinh,
    51: ca.asin,
    52: ca.acosh,
    53: ca.acos,
    76: lambda a: a**2,
}
"""Mapping from operator numbers to functions of one argument."""
_BINARY: dict[int, Callable[[Any, Any], Any]] = {
    0: lambda a, b: a + b,
    1: lambda a, b: a - b,
    2: lambda a, b: a * b,
    3: lambda a, b: a / b,
    5: lambda a, b: a**b,
    48: ca.atan2,
    75: lambda a, b: a**b,
    77: lambda a, b: a**b,
}
"""Mapping from operator numbers to functions of two arguments."""
_SUMS: dict[int, Callable[[Any, Any], Any]] = {
    11: ca.fmin,
    12: ca.fmax,
    54: lambda a, b: a + b,
}
"""Mapping from numbers of operators with any number of arguments to functions that add one argument to the result."""
_HEADER_LINES = 10
"""Number of lines before the first segment."""
_INTEGER_LINE = 6
"""Index of the header's line with the numbers of binary and integer variables."""
_FREE = 3
"""Kind of bounds in an r- or b-line: none."""
_FIXED = 4
"""Kind of bounds in an r- or b-line: both ends equal."""
_COMPLEMENTS = 5
"""Kind of bounds in an r-line: the row is complementary to a variable."""

Line = list[str]
"""Words of one line, without its comment."""
Term = tuple[int, float]
"""Index of a variable and its coefficient."""
Ends = tuple[float, float]
"""Lower and upper bound."""


@dataclass
class NLFile:
    """Segments of a file as expressions in the variables ``x`` (n, 1).

    ``bodies`` are the nonlinear parts of the rows, ``linear`` their linear ones; ``row_ends`` and
    ``x_ends`` are the bounds of rows and variables; ``complements`` maps a row to the kind k and the
    variable j (from 0) of an r-line ``5 k j``. ``defined`` maps numbers of variables, and of common
    expressions, to what they stand for; ``options`` are the numbers of the first line. Of the variables,
    ``n_integer`` are integers, which are read as real numbers.
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
    n, m = int(lines[1][0]), int(lines[1][1])
    symbols = [ca.SX.sym(title) for title in names] if len(names) == n else ca.vertsplit(ca.SX.sym("x", n))
    n_integer = sum(int(number) for number in lines[_INTEGER_LINE])
    contents = NLFile(ca.vertcat(ca.SX(0, 1), *symbols), m, [int(word) for word in lines[0][1:]], n_integer)
    contents.defined = dict(enumerate(symbols))
    position = _HEADER_LINES
    while position < len(lines):
        try:
            position = _read_segment(contents, lines, position)
        except (ValueError, IndexError, KeyError) as error:
            raise InputError(f"{name}: line {position + 1} begins no segment that can be read: {error}") from error
    return contents


def _read_segment(contents: NLFile, lines: list[Line], position: int) -> int:
    """Read the segment that begins at a line; return the line of the next one."""
    if not lines[position]:
        return position + 1
    kind, number = lines[position][0][0], lines[position][0][1:]
    counts = [int(word) for word in lines[position][1:] if word.lstrip("-").isdigit()]
    first = position + 1
    if kind in "CO":
        value, end = _expression(contents, lines, first)
        if kind == "C":
            contents.bodies[int(number)] = value
        elif number == "0":
            contents.objective, contents.maximise = value, bool(counts[0])
        return end
    if kind == "V":
        terms = _terms(lines[first : first + counts[0]])
        value, end = _expression(contents, lines, first + counts[0])
        contents.defined[int(number)] = contents.sum_terms(value, terms)
        return end
    if kind in "JG":
        terms = _terms(lines[first : first + counts[0]])
        if kind == "J":
            contents.linear[int(number)] = terms
        elif number == "0":
            contents.gradient = terms
        return first + counts[0]
    if kind == "S":
        return first + counts[0]
    return first + _read_table(contents, lines[first:], kind, number)


def _read_table(contents: NLFile, lines: list[Line], kind: str, number: str) -> int:
    """Read bounds or starts; return their number of lines. Initial duals and column counts are skipped."""
    if kind == "r":
        for i, words in enumerate(lines[: contents.n_rows]):
            is_pair = words[0] == str(_COMPLEMENTS)
            if is_pair:
                contents.complements[i] = int(words[1]), int(words[2]) - 1
            contents.row_ends.append((-math.inf, math.inf) if is_pair else _ends(words))
        return contents.n_rows
    if kind == "b":
        contents.x_ends = [_ends(words) for words in lines[: contents.x.numel()]]
        return contents.x.numel()
    if kind == "x":
        contents.start = dict(_terms(lines[: int(number)]))
    elif kind not in ("d", "k"):
        raise ValueError(f"{kind + number!r} is not known")
    return int(number)


def _terms(lines: list[Line]) -> list[Term]:
    return [(int(index), float(value)) for index, value in lines]


def _ends(words: Line) -> Ends:
    kind, numbers = int(words[0]), [float(word) for word in words[1:]]
    if kind == 0:
        return numbers[0], numbers[1]
    if kind == 1:
        return -math.inf, numbers[0]
    if kind == 2:
        return numbers[0], math.inf
    if kind == _FREE:
        return -math.inf, math.inf
    if kind == _FIXED:
        return numbers[0], numbers[0]
    raise ValueError(f"bounds of type {kind} are not known")


def _expression(contents: NLFile, lines: list[Line], first: int) -> tuple[Any, int]:
    """Return the expression in prefix form that begins at a line, evaluated from its last line, and its end."""
    end = first
    while end < len(lines) and lines[end] and lines[end][0][0] in "onv0123456789":
        end += 1
    stack: list[Any] = []
    for line in reversed(lines[first:end]):
        word = line[0]
        if word[0] == "n":
            stack.append(float(word[1:]))
        elif word[0] == "v":
            stack.append(contents.defined[int(word[1:])])
        elif word[0] == "o":
            stack.append(_apply(int(word[1:]), stack))
        else:
            stack.append(int(word))
    (value,) = stack
    return value, end


def _apply(operator: int, stack: list[Any]) -> Any:
    """Return an operator's value at the arguments on top of the stack, which are taken from it."""
    if operator in _UNARY:
        return _UNARY[operator](stack.pop())
    if operator in _BINARY:
        first, second = stack.pop(), stack.pop()
        return _BINARY[operator](first, second)
    if operator in _SUMS:
        count = stack.pop()
        value = stack.pop()
        for _ in range(count - 1):
            value = _SUMS[operator](value, stack.pop())
        return value
    raise ValueError(f"operator o{operator} is not known")
