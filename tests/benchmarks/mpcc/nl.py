"""Complementarity problems from AMPL's .nl text files (D. M. Gay, Writing .nl files, 2005)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from ocp.errors import InputError
from ocp.mpcc import MPCC

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
_MANY: dict[int, Callable[[Any, Any], Any]] = {
    11: ca.fmin,
    12: ca.fmax,
    54: lambda a, b: a + b,
}
_FREE, _FIXED, _COMPLEMENTS = 3, 4, 5


@dataclass
class NL:
    """Contents of a file's segments, before they become a problem.

    ``bodies`` are the nonlinear parts of the rows, ``linear`` their linear ones; ``ends`` and
    ``limits`` hold (lower, upper) of rows and variables; ``complements`` maps a row to the kind k
    and the variable j (from 0) of an r-line ``5 k j``.
    """

    x: ca.SX
    rows: int
    defined: dict[int, Any] = field(default_factory=dict)
    bodies: dict[int, Any] = field(default_factory=dict)
    linear: dict[int, list[tuple[int, float]]] = field(default_factory=dict)
    objective: Any = 0.0
    gradient: list[tuple[int, float]] = field(default_factory=list)
    maximise: bool = False
    ends: list[tuple[float, float]] = field(default_factory=list)
    limits: list[tuple[float, float]] = field(default_factory=list)
    complements: dict[int, tuple[int, int]] = field(default_factory=dict)
    start: dict[int, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Stated:
    """A problem to be minimised, its start, and whether the file maximises."""

    mpcc: MPCC
    start: np.ndarray
    maximise: bool


def read_nl(path: Path) -> Stated:
    """Return the problem of a file, with the file's name; it starts at zero if no start is given.

    Raises :class:`~ocp.errors.InputError` for anything but a text file of known operators.
    """
    return problem_of(parse_nl(path.read_text(), path.stem), path.stem)


def parse_nl(text: str, name: str) -> NL:
    """Read the segments of a file."""
    lines = [line.partition("#")[0].split() for line in text.splitlines()]
    if len(lines) < 10 or not lines[0][0].startswith("g"):
        raise InputError(f"{name}: not an AMPL .nl text file")
    n, m = int(lines[1][0]), int(lines[1][1])
    found = NL(ca.SX.sym("x", n), m)
    found.defined = {i: found.x[i] for i in range(n)}
    at = 10
    while at < len(lines):
        try:
            at = _segment(found, lines, at)
        except (ValueError, IndexError, KeyError) as error:
            raise InputError(f"{name}: line {at + 1} begins no segment: {error}") from error
    return found


def _segment(found: NL, lines: list[list[str]], at: int) -> int:
    """Read the segment that begins at a line; return the line of the next one."""
    if not lines[at]:
        return at + 1
    kind, number = lines[at][0][0], lines[at][0][1:]
    rest, after = [int(word) for word in lines[at][1:] if word.lstrip("-").isdigit()], at + 1
    if kind in "CO":
        value, end = _expression(found, lines, after)
        if kind == "C":
            found.bodies[int(number)] = value
        elif number == "0":
            found.objective, found.maximise = value, bool(rest[0])
        return end
    if kind == "V":
        terms = _terms(lines[after : after + rest[0]])
        value, end = _expression(found, lines, after + rest[0])
        found.defined[int(number)] = _sum(found, value, terms)
        return end
    if kind in "JG":
        terms = _terms(lines[after : after + rest[0]])
        if kind == "J":
            found.linear[int(number)] = terms
        elif number == "0":
            found.gradient = terms
        return after + rest[0]
    return _table(found, lines, kind, number, rest, after)


def _table(found: NL, lines: list[list[str]], kind: str, number: str, rest: list[int], after: int) -> int:
    """Read a segment of numbers, such as bounds or starts; segments without meaning here are skipped."""
    if kind == "r":
        for i in range(found.rows):
            words = lines[after + i]
            if words[0] == str(_COMPLEMENTS):
                found.complements[i] = int(words[1]), int(words[2]) - 1
                found.ends.append((-math.inf, math.inf))
            else:
                found.ends.append(_ends(words))
        return after + found.rows
    if kind == "b":
        n = found.x.numel()
        found.limits = [_ends(words) for words in lines[after : after + n]]
        return after + n
    if kind == "x":
        found.start = dict(_terms(lines[after : after + int(number)]))
        return after + int(number)
    if kind in "dk":
        return after + int(number)
    if kind == "S":
        return after + rest[0]
    raise ValueError(f"{kind + number!r} is not known")


def _terms(lines: list[list[str]]) -> list[tuple[int, float]]:
    return [(int(index), float(value)) for index, value in lines]


def _ends(words: list[str]) -> tuple[float, float]:
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


def _expression(found: NL, lines: list[list[str]], at: int) -> tuple[Any, int]:
    """Evaluate an expression in prefix form, from its last line to its first."""
    end = at
    while end < len(lines) and lines[end] and lines[end][0][0] in "onv0123456789":
        end += 1
    stack: list[Any] = []
    for i in range(end - 1, at - 1, -1):
        word = lines[i][0]
        if word[0] == "n":
            stack.append(float(word[1:]))
        elif word[0] == "v":
            stack.append(found.defined[int(word[1:])])
        elif word[0] == "o":
            stack.append(_applied(int(word[1:]), stack))
        else:
            stack.append(int(word))
    (value,) = stack
    return value, end


def _applied(operator: int, stack: list[Any]) -> Any:
    if operator in _UNARY:
        return _UNARY[operator](stack.pop())
    if operator in _BINARY:
        first, second = stack.pop(), stack.pop()
        return _BINARY[operator](first, second)
    if operator in _MANY:
        count = stack.pop()
        value = stack.pop()
        for _ in range(count - 1):
            value = _MANY[operator](value, stack.pop())
        return value
    raise ValueError(f"operator o{operator} is not known")


def _sum(found: NL, value: Any, terms: list[tuple[int, float]]) -> Any:
    for index, factor in terms:
        if factor:
            value = value + factor * found.defined[index]
    return value


def problem_of(found: NL, name: str) -> Stated:
    """Return a file's rows and complementarities as a problem.

    With the body c of a row and the bounds l, u of its variable x_j: k = 1 is
    ``0 <= c ⟂ x_j - l >= 0``; k = 2 is ``0 <= -c ⟂ u - x_j >= 0``; k = 3 is ``c = w - v``,
    ``0 <= w ⟂ x_j - l >= 0`` and ``0 <= v ⟂ u - x_j >= 0``; k = 0 is ``c = 0``. A pair whose sides
    are the same expression means that it is zero.
    """
    rows, ends, firsts, seconds, names = [], [], [], [], []
    mixed = [i for i, (kind, _) in found.complements.items() if kind == 3]
    parts = ca.SX.sym("w", 2 * len(mixed))
    for i in range(found.rows):
        body = _sum(found, found.bodies.get(i, 0.0), found.linear.get(i, []))
        kind, j = found.complements.get(i, (-1, -1))
        lower, upper = found.limits[j] if j >= 0 else (0.0, 0.0)
        below, above = found.x[max(j, 0)] - lower, upper - found.x[max(j, 0)]
        if kind in (-1, 0):
            rows.append(body)
            ends.append(found.ends[i] if kind < 0 else (0.0, 0.0))
        elif kind == 3:
            at = 2 * mixed.index(i)
            rows.append(body - parts[at] + parts[at + 1])
            ends.append((0.0, 0.0))
            firsts += [parts[at], parts[at + 1]]
            seconds += [below, above]
            names += [f"row {i} below", f"row {i} above"]
        else:
            first, second = (body, below) if kind == 1 else (-body, above)
            if ca.is_equal(ca.SX(first), second, 2):
                rows.append(body)
                ends.append((0.0, 0.0))
                continue
            firsts.append(first)
            seconds.append(second)
            names.append(f"row {i}")
    f = _sum(found, found.objective, found.gradient)
    limits = np.array([*found.limits, *[(0.0, math.inf)] * (2 * len(mixed))]).reshape(-1, 2)
    ranges = np.array(ends).reshape(-1, 2)
    x = ca.vertcat(found.x, parts)
    start = np.zeros(x.numel())
    start[list(found.start)] = list(found.start.values())
    empty = ca.SX(0, 1)
    stated = MPCC(
        x,
        -f if found.maximise else f,
        ca.vertcat(empty, *firsts),
        ca.vertcat(empty, *seconds),
        ca.vertcat(empty, *rows),
        lbx=limits[:, 0],
        ubx=limits[:, 1],
        lbg=ranges[:, 0],
        ubg=ranges[:, 1],
        names=names,
        name=name,
    )
    return Stated(stated, start, found.maximise)
