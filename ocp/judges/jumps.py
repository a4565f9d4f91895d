"""Operations at which costs, constraints, dynamics and gaps jump, which derivatives do not show."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import casadi as ca
import numpy as np

from ocp.problem import SWEPT, Problem

_SWITCHES = {
    ca.OP_LT: "<", ca.OP_LE: "<=", ca.OP_EQ: "==", ca.OP_NE: "!=", ca.OP_FLOOR: "floor",
    ca.OP_CEIL: "ceil", ca.OP_SIGN: "sign", ca.OP_FMOD: "fmod", ca.OP_REMAINDER: "remainder",
    ca.OP_COPYSIGN: "copysign", ca.OP_ATAN2: "atan2",
}  # fmt: skip
_QUOTIENTS = {ca.OP_DIV: "division", ca.OP_INV: "division", ca.OP_POW: "power",
              ca.OP_CONSTPOW: "power"}  # fmt: skip
_CALLS = (-1, 48)
"""What CasADi reports as the operation of an output of a call, and of the call."""
_LINES, _FOLLOWED = 64, 16
"""Lines that are drawn, and those of them on which one switch is followed."""
_HALVINGS, _GRID = 60, np.linspace(0, 1, 33)
_NEAR_ZERO = 0.1
"""Share of its largest value on a line below which a divisor may have a zero beside a place."""
_SEEN, _ROUNDING = 1e-9, 1e-12
"""What counts as a jump, of the values beside it, and of those at the ends of the line."""
_ASIDE = (1e-6, 1e-9, 1e-12)
"""Distances from a zero of a divisor, in lengths of the line, at which its sides are compared."""
_POINT = 1e-12
"""Coordinates below that share of the line's are rounded to zero, to meet ``x == 0`` exactly."""
_GOLDEN = (5**0.5 - 1) / 2


@dataclass(frozen=True)
class Domain:
    """Box ``lower <= z <= upper`` in which variables move, and their ``sizes``, (n,) each.

    Half of its lines run about ``centre`` (n,), the others about zero. Where ``slack(z)`` has an
    entry below zero a constraint is violated, and a jump does not count.
    """

    sizes: np.ndarray
    lower: np.ndarray | float = -np.inf
    upper: np.ndarray | float = np.inf
    centre: np.ndarray | float = 0.0
    slack: ca.Function | None = None

    @cached_property
    def ends(self) -> tuple[np.ndarray, np.ndarray]:
        """Ends (n, L) of lines, random points a hundredth to a hundred times the sizes away."""
        rng, n = np.random.default_rng(0), self.sizes.size
        far = 10.0 ** rng.uniform(-2, 2, (2, _LINES, 1))
        about = np.where(np.arange(_LINES)[:, None] % 2, self.centre, 0.0)
        ends = about + self.sizes * far * rng.normal(size=(2, _LINES, n))
        low, high = np.clip(ends, self.lower, self.upper)
        return low.T, high.T

    @cached_property
    def places(self) -> ca.DM:
        """Equidistant points (n, P L) of all lines, line by line for each place."""
        low, high = self.ends
        return ca.DM(np.concatenate([low + t * (high - low) for t in _GRID], axis=1))

    def allowed(self, points: np.ndarray) -> np.ndarray:
        """Which of ``points`` (n, L) violate no constraint."""
        if self.slack is None:
            return np.ones(points.shape[1], dtype=bool)
        return ~np.any(_at(self.slack, points) < 0, axis=0)


@lru_cache(maxsize=16)
def jump_findings(problem: Problem) -> tuple[str, ...]:
    """Sentences on what jumps in a problem within its bounds, and on what cannot be inspected.

    Impulses of friction are zero, and their own gaps left out: the basis of their tangents may
    turn, which changes no physics. The coefficient of friction is in the gaps of slip.
    """
    system, p = problem.system, problem.parameters
    du = ca.SX.sym("du", system.nu) if problem.du is None else problem.du
    rows = [row for row in (*problem.path, *problem.terminal) if row.name != SWEPT]
    tangential = np.array([pair.kind == "friction" for pair in system.pairs], dtype=bool)
    gaps = system.gap[np.flatnonzero(~tangential).tolist()]
    parts = {"stage_cost": problem.stage_cost, "terminal_cost": problem.terminal_cost}
    parts |= {row.name: row.expression for row in rows}
    parts |= {"dynamics": system.residual, "gaps": gaps}
    moving = ca.vertcat(system.x, system.u, du, system.x_next, system.lam)
    fixed = {name: ca.substitute(part, p.vector, p.values) for name, part in parts.items()}
    return jump_findings_of(
        fixed, moving, _domain(problem, moving, np.where(tangential, 0.0, np.inf))
    )


def _domain(problem: Problem, moving: ca.SX, most_lam: np.ndarray) -> Domain:
    """Where ``x, u, du, x_next, lam`` are on plans, by bounds, distances and path inequalities."""
    system, sizes, p = problem.system, problem.scales, problem.parameters
    x0, u0, u_low, u_high, x_low, x_high = (
        np.array(value).ravel() for value in problem.limits(p.values)
    )
    none = np.zeros(system.nlam)
    slack = [] if system.phi is None else [
        system.phi, ca.substitute(system.phi, system.x, system.x_next)
    ]  # fmt: skip
    for row in problem.path:
        low, high = (ca.evalf(ca.substitute(end, p.vector, p.values)) for end in
                     (row.lower, row.upper))  # fmt: skip
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


def jump_findings_of(parts: Mapping[str, ca.SX], moving: ca.SX, domain: Domain) -> tuple[str, ...]:
    """Sentences on the jumps of named ``parts``, expressions in ``moving`` (n, 1) alone."""
    names = [f"{jump} in {name}" for name, part in parts.items()
             for jump in jumps(part, moving, domain)]  # fmt: skip
    calls = [f"{node} in {name}" for name, part in parts.items()
             for node in dict.fromkeys(_calls(part))]  # fmt: skip
    told = []
    if names:
        told.append(
            f"The problem jumps ({', '.join(names)}), which derivatives do not show: the"
            " certificate holds only between jumps."
        )
    if calls:
        told.append(
            f"Functions from outside are not inspected for jumps ({', '.join(calls)}): the"
            " certificate holds only where they are smooth."
        )
    return tuple(told)


def jumps(expression: ca.SX, moving: ca.SX, domain: Domain) -> list[str]:
    """Names of the operations at which ``expression`` (k, 1) jumps as ``moving`` (n, 1) moves.

    It may use no other symbols. On straight lines through the domain a place where an operation of
    the graph switches is found by bisection, or where a divisor is zero by minimisation, and the
    values on its two sides compared: ``if_else`` that is continuous, as Huber's loss is, does not
    jump, nor does ``sqrt(x**2)``, nor a switch that no line crosses. A pole, whose values grow
    without end, is no jump.
    """
    values = ca.Function("values", [moving], [ca.densify(expression)])
    found: list[str] = []
    divisors: set[int] = set()
    for node in _nodes(expression):
        if node.op() in _QUOTIENTS:
            name, divisor = _QUOTIENTS[node.op()], node.dep(node.op() == ca.OP_DIV)
            if name in found or divisor.element_hash() in divisors:
                continue
            divisors.add(divisor.element_hash())
            sides, jumped = [ca.fabs(divisor)], _jumps_at_zero
        else:
            name, jumped = _SWITCHES.get(node.op(), ""), _jumps_at_switch
            sides = [ca.vertcat(side, node) for side in _sides(node)] if name else []
        if name in found or not ca.depends_on(node, moving):
            continue
        followed = (ca.Function("side", [moving], [side]) for side in sides)
        found += [name] if any(jumped(side, values, domain) for side in followed) else []
    return found


def _nodes(expression: ca.SX) -> Iterator[ca.SX]:
    """Every operation of a graph, once."""
    seen: set[int] = set()
    left: list[Any] = list(expression.nz)
    while left:
        node = left.pop()
        if node.is_leaf() or node.element_hash() in seen:
            continue
        seen.add(node.element_hash())
        yield node
        left += [node.dep(k) for k in range(node.n_dep())]


def _calls(expression: ca.SX) -> Iterator[str]:
    """Names of the functions that a graph calls, which have no graph in it."""
    for node in _nodes(expression):
        if node.op() in _CALLS:
            yield str(node).partition("(")[0]


def _sides(node: ca.SX) -> list[ca.SX]:
    """Expressions, constant between the places where an operation may jump."""
    first, second = node.dep(0), node.dep(node.n_dep() - 1)
    if node.op() in (ca.OP_EQ, ca.OP_NE):
        return [first < second]
    if node.op() == ca.OP_FMOD:
        return [ca.sign(first / second) * ca.floor(ca.fabs(first / second))]
    if node.op() == ca.OP_REMAINDER:
        return [ca.floor(first / second + 0.5)]
    if node.op() == ca.OP_COPYSIGN:
        return [second < 0]
    return [first < 0, second < 0] if node.op() == ca.OP_ATAN2 else [node]


def _at(function: ca.Function, points: np.ndarray | ca.DM) -> np.ndarray:
    return np.array(function(points))


def _jumps_at_switch(side: ca.Function, values: ca.Function, domain: Domain) -> bool:
    """Whether values differ on the two sides of a switch, or on it where two terms are equal."""
    low, high = domain.ends
    before, after = _at(side, low)[:1], _at(side, high)[:1]
    crossed = np.flatnonzero(np.isfinite(before + after) & (before != after))[:_FOLLOWED]
    if not crossed.size:
        return False
    low, high, before = low[:, crossed], high[:, crossed], before[:, crossed]
    length = np.abs(high - low)
    scale = sum(np.abs(_at(values, end)) for end in (low, high))
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        same = _at(side, middle)[:1] == before
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    on = np.where(np.abs(low) < _POINT * length, 0.0, low)
    first, last, between = (_at(values, point) for point in (low, high, on))
    least = _SEEN * (np.abs(first) + np.abs(last)) + _ROUNDING * scale
    beside = (np.minimum(first, last) - between, between - np.maximum(first, last))
    switched = _at(side, on)[1:] != _at(side, low)[1:]
    point = switched & (np.maximum(*beside) > least)
    jumped = (np.abs(first - last) > least) | point
    return bool(np.any(jumped & domain.allowed(low) & domain.allowed(high)))


def _jumps_at_zero(size: ca.Function, values: ca.Function, domain: Domain) -> bool:
    """Whether values differ by the same on the two sides of a divisor's zero, however near."""
    low, high = domain.ends
    sizes = _at(size, domain.places).reshape(_GRID.size, -1)
    least, most = np.clip(sizes.argmin(axis=0), 1, _GRID.size - 2), sizes.max(axis=0)
    tried = np.flatnonzero(sizes.min(axis=0) < _NEAR_ZERO * most)[:_FOLLOWED]
    if not tried.size:
        return False
    low, way, most = low[:, tried], (high - low)[:, tried], most[tried]
    begin, end = _GRID[least[tried] - 1], _GRID[least[tried] + 1]
    for _ in range(2 * _HALVINGS):
        inner, outer = end - _GOLDEN * (end - begin), begin + _GOLDEN * (end - begin)
        left = _at(size, low + inner * way)[0] < _at(size, low + outer * way)[0]
        begin, end = np.where(left, begin, inner), np.where(left, outer, end)
    zero = (begin + end) / 2
    met = _at(size, low + zero * way)[0] <= _SEEN * most
    met &= (zero > _ASIDE[0]) & (zero < 1 - _ASIDE[0]) & domain.allowed(low + zero * way)
    sides = np.array([
        [_at(values, low + (zero + aside) * way) for aside in (-distance, distance)]
        for distance in _ASIDE
    ])  # fmt: skip
    steps = np.abs(sides[:, 1] - sides[:, 0])
    least = np.fmax(0.5 * steps.max(axis=0), _SEEN * np.abs(sides[0]).sum(axis=0))
    return bool(np.any(met & (steps.min(axis=0) > least)))
