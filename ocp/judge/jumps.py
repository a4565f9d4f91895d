"""Detection of jumps in costs, constraints, dynamics and gaps, which derivatives do not reveal."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import casadi as ca
import numpy as np

from ocp.judge.findings import Finding, make_finding
from ocp.problem.problem import SWEPT, Problem

_SWITCHES = {
    ca.OP_LT: "<",
    ca.OP_LE: "<=",
    ca.OP_EQ: "==",
    ca.OP_NE: "!=",
    ca.OP_FLOOR: "floor",
    ca.OP_CEIL: "ceil",
    ca.OP_SIGN: "sign",
    ca.OP_FMOD: "fmod",
    ca.OP_REMAINDER: "remainder",
    ca.OP_COPYSIGN: "copysign",
    ca.OP_ATAN2: "atan2",
    ca.OP_FABS: "x/|x|",
    ca.OP_DIV: "division",
    ca.OP_INV: "division",
}
"""Mapping from CasADi operations that may jump to their names."""
_CALLS = (-1, 48)
"""CasADi's operation codes of the output of a function call, and of the call itself."""
_LINES = 64
"""Number of random lines along which jumps are searched for."""
_LINES_PER_SWITCH = 16
"""Maximum number of lines on which a single switch is located."""
_BISECTIONS = 60
"""Number of bisections that locate a switch."""
_JUMP_SHARE = 1e-9
"""Difference between the two sides of a switch, as a fraction of the values, above which the switch is a jump."""
_ROUNDING_SHARE = 1e-12
"""Tolerance on a jump for rounding errors, as a fraction of the values at the ends of a line."""
_ASIDE_SHARE = 1e-6
"""Distance from a switch, as a fraction of the line, of the points compared with the values at the switch."""
_POLE_RATIO = 1e4
"""Ratio of the value at a switch to the value :data:`_ASIDE_SHARE` away from it above which the switch is a pole."""
_UNKNOWN_SHARE = 1e-3
"""Difference, as a fraction of the values at a line's ends, that is a jump if values at the switch are NaN."""
_ZERO_SHARE = 1e-12
"""Fraction of the line below which coordinates are rounded to zero, so that ``x == 0`` holds exactly."""


@dataclass(frozen=True)
class Domain:
    """Box ``lower <= z <= upper``, (n,) each, of variables with characteristic ``sizes``, searched for jumps.

    The search follows random lines; half of them are drawn around ``centre`` (n,), the others around
    zero. A point where ``slack(z)`` has a negative entry violates a constraint; jumps there are ignored.
    """

    sizes: np.ndarray
    lower: np.ndarray | float = -np.inf
    upper: np.ndarray | float = np.inf
    centre: np.ndarray | float = 0.0
    slack: ca.Function | None = None

    @cached_property
    def ends(self) -> tuple[np.ndarray, np.ndarray]:
        """First and last points (n, L) of random lines, 0.01 to 100 sizes from their centres."""
        rng, n = np.random.default_rng(0), self.sizes.size
        distances = 10.0 ** rng.uniform(-2, 2, (2, _LINES, 1))
        centres = np.where(np.arange(_LINES)[:, None] % 2, self.centre, 0.0)
        ends = centres + self.sizes * distances * rng.normal(size=(2, _LINES, n))
        low, high = np.clip(ends, self.lower, self.upper)
        return low.T, high.T

    def allowed(self, points: np.ndarray) -> np.ndarray:
        """Return a mask (L,) of the ``points`` (n, L) that violate no constraint."""
        if self.slack is None:
            return np.ones(points.shape[1], dtype=bool)
        return ~np.any(_at(self.slack, points) < 0, axis=0)


@lru_cache(maxsize=16)
def jump_findings(problem: Problem) -> tuple[Finding, ...]:
    """Return findings on operations at which a problem jumps, and on functions that cannot be examined.

    Friction impulses are set to zero and friction gaps are left out, since the basis of the tangents
    may jump without an effect on the physics. Slip gaps, which contain the friction coefficient, are examined.
    """
    system, p = problem.system, problem.parameters
    x, u, du, lam, _ = problem.symbols
    rows = [row for row in (*problem.path, *problem.terminal) if row.name != SWEPT]
    tangential = np.array([pair.kind == "friction" for pair in system.pairs], dtype=bool)
    gaps = system.gap[np.flatnonzero(~tangential).tolist()]
    expressions = {"stage_cost": problem.stage_cost, "terminal_cost": problem.terminal_cost}
    expressions |= {row.name: row.expression for row in rows}
    expressions |= {"dynamics": system.residual, "gaps": gaps}
    moving = ca.vertcat(x, u, du, system.x_next, lam)
    evaluated = {name: ca.substitute(expression, p.vector, p.values) for name, expression in expressions.items()}
    return jump_findings_of(evaluated, moving, _domain(problem, moving, np.where(tangential, 0.0, np.inf)))


def _domain(problem: Problem, moving: ca.SX, most_lam: np.ndarray) -> Domain:
    """Return the domain of ``x, u, du, x_next, lam``; bounds, distances, inequalities and ``most_lam`` limit it."""
    system, sizes, p = problem.system, problem.scales, problem.parameters
    x0, u0, u_low, u_high, x_low, x_high = (np.array(value).ravel() for value in problem.limits(p.values))
    none, slack = np.zeros(system.nlam), list[ca.SX]()
    if system.phi is not None:
        slack = [system.phi, ca.substitute(system.phi, system.x, system.x_next)]
    for row in problem.path:
        low, high = (ca.evalf(ca.substitute(end, p.vector, p.values)) for end in (row.lower, row.upper))
        open_rows = np.flatnonzero(np.array(low < high)).tolist()
        slack += [(row.expression - low)[open_rows], (high - row.expression)[open_rows]]
    constant = ca.substitute(ca.vertcat(ca.SX(0, 1), *slack), p.vector, p.values)
    return Domain(
        np.concatenate([sizes.x, sizes.u, sizes.u, sizes.x, np.full(system.nlam, sizes.impulse)]),
        np.concatenate([x_low, u_low, u_low - u_high, x_low, none]),
        np.concatenate([x_high, u_high, u_high - u_low, x_high, most_lam]),
        np.concatenate([x0, u0, 0 * u0, x0, none]),
        ca.Function("slack", [moving], [ca.densify(constant)]),
    )


def jump_findings_of(expressions: Mapping[str, ca.SX], moving: ca.SX, domain: Domain) -> tuple[Finding, ...]:
    """Return the names of the operations at which ``expression`` (k, 1) jumps as ``moving`` (n, 1) changes."""

    operations = {name: _operations(expression) for name, expression in expressions.items()}

    def located(find: Callable[[ca.SX], Iterable[str]], codes: Iterable[int]) -> list[str]:
        examined = [name for name in expressions if not operations[name].isdisjoint(codes)]
        return [f"{node} in {name}" for name in examined for node in find(expressions[name])]

    names = located(lambda expression: jumping_operations(expression, moving, domain), _SWITCHES)
    calls = located(_calls, _CALLS)
    findings = []
    if names:
        findings.append(make_finding("problem-jumps", operations=", ".join(names)))
    if calls:
        findings.append(make_finding("functions-not-inspected", functions=", ".join(calls)))
    return tuple(findings)


def _operations(expression: ca.SX) -> set[int]:
    """Return the codes of a graph's operations; most graphs have none that may jump, and need no walk."""
    function = ca.Function("graph", ca.symvar(expression), [expression])
    return {function.instruction_id(k) for k in range(function.n_instructions())}


def jumping_operations(expression: ca.SX, moving: ca.SX, domain: Domain) -> list[str]:
    """Return the names of the operations at which ``expression`` (k, 1) jumps as ``moving`` (n, 1) moves.

    The expression may contain no other symbols. On straight lines through the domain, bisection locates
    points where an operation of the graph switches, or a divisor or an absolute value changes sign; the
    values on the two sides are compared. A continuous ``if_else``, such as Huber's loss, is no jump,
    nor are ``sqrt(x**2)`` and poles. Switches that no line crosses are not detected.
    """
    switches = [
        (_SWITCHES[node.op()], node, side)
        for node in _nodes(expression)
        if node.op() in _SWITCHES
        for side in _sides(node)
    ]
    sides = ca.Function("sides", [moving], [ca.densify(ca.vertcat(ca.SX(0, 1), *(side for *_, side in switches)))])
    low, high = (_at(sides, points) for points in domain.ends)
    crossed = np.isfinite(low + high) & (low != high)
    values = ca.Function("values", [moving], [ca.densify(expression)])
    names: list[str] = []
    for (name, node, side), is_crossed in zip(switches, crossed, strict=True):
        if name not in names and is_crossed.any():
            side_function = ca.Function("side", [moving], [side, node])
            names += [name] if _jumps_at(side_function, values, domain, is_crossed) else []
    return names


def _nodes(expression: ca.SX) -> Iterator[ca.SX]:
    """Yield every operation of a graph once."""
    visited: set[int] = set()
    pending: list[Any] = list(expression.nz)
    while pending:
        node = pending.pop()
        if node.is_leaf() or node.element_hash() in visited:
            continue
        visited.add(node.element_hash())
        yield node
        pending += [node.dep(k) for k in range(node.n_dep())]


def _calls(expression: ca.SX) -> dict[str, None]:
    """Return the names, as keys, of the functions that a graph calls without containing their graphs."""
    calls = (str(node) for node in _nodes(expression) if node.op() in _CALLS)
    return dict.fromkeys(call.partition("(")[0] for call in calls)


def _sides(node: ca.SX) -> list[ca.SX]:
    """Return piecewise constant expressions that change at points where an operation may jump."""
    operation, first, second = node.op(), node.dep(0), node.dep(node.n_dep() - 1)
    if operation in (ca.OP_EQ, ca.OP_NE):
        return [first < second]
    if operation == ca.OP_FMOD:
        return [ca.sign(first / second) * ca.floor(ca.fabs(first / second))]
    if operation == ca.OP_REMAINDER:
        return [ca.floor(first / second + 0.5)]
    if operation in (ca.OP_COPYSIGN, ca.OP_FABS, ca.OP_DIV, ca.OP_INV):
        return [second < 0]
    return [first < 0, second < 0] if operation == ca.OP_ATAN2 else [node]


def _at(function: ca.Function, points: np.ndarray, output: int = 0) -> np.ndarray:
    return np.array(function(points) if function.n_out() == 1 else function(points)[output])


@np.errstate(invalid="ignore")
def _jumps_at(side: ca.Function, values: ca.Function, domain: Domain, is_crossed: np.ndarray) -> bool:
    """Return whether ``values`` jump at a switch that lines (L,) cross: between its sides, or on the switch itself."""
    crossing = np.flatnonzero(is_crossed)[:_LINES_PER_SWITCH]
    low, high = (points[:, crossing] for points in domain.ends)
    side_low = _at(side, low)
    ends, scale = (low, high), np.abs(_at(values, low)) + np.abs(_at(values, high))
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2
        unchanged = _at(side, middle) == side_low
        low, high = np.where(unchanged, middle, low), np.where(unchanged, high, middle)
    on_switch = np.where(np.abs(low) < _ZERO_SHARE * np.abs(ends[1] - ends[0]), 0.0, low)
    value_low, value_high, value_on = (_at(values, is_point) for is_point in (low, high, on_switch))
    values_aside = [_at(values, low + _ASIDE_SHARE * (end - low)) for end in ends]
    pole = np.abs(value_low) > _POLE_RATIO * np.abs(values_aside[0])
    tolerance = _JUMP_SHARE * (np.abs(value_low) + np.abs(value_high)) + _ROUNDING_SHARE * scale
    beyond_both = np.maximum(np.minimum(value_low, value_high) - value_on, value_on - np.maximum(value_low, value_high))
    is_point = np.isfinite(beyond_both) & (beyond_both > tolerance) & (_at(side, on_switch, 1) != _at(side, low, 1))
    # A quotient of zeros is NaN: values a little farther from the switch are compared, with a larger tolerance.
    is_unknown = np.isnan(value_low + value_high) & (np.abs(values_aside[1] - values_aside[0]) > _UNKNOWN_SHARE * scale)
    jumped = ((np.abs(value_low - value_high) > tolerance) & ~pole) | is_point | is_unknown
    return bool(np.any(jumped & domain.allowed(low) & domain.allowed(high)))
