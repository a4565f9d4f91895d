"""Where costs and constraints jump: operations whose value does, and derivatives do not see it."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache

import casadi as ca
import numpy as np

from ocp.problem import Problem

_COMPARED = {ca.OP_LT: "<", ca.OP_LE: "<=", ca.OP_EQ: "==", ca.OP_NE: "!="}
_STEPS = {
    ca.OP_FLOOR: "floor", ca.OP_CEIL: "ceil", ca.OP_SIGN: "sign", ca.OP_FMOD: "fmod",
    ca.OP_REMAINDER: "remainder", ca.OP_COPYSIGN: "copysign",
}  # fmt: skip
_LINES, _HALVINGS = 64, 60
_SEEN, _ROUNDING = 1e-9, 1e-12
"""What counts as a jump, of the values beside it, and of those at the ends of the line."""


@lru_cache(maxsize=16)
def jumps_of(problem: Problem) -> tuple[str, ...]:
    """Operations at which costs or constraints jump, ``floor in stage_cost`` and the like."""
    system, sizes = problem.system, problem.sizes
    du = ca.SX.sym("du", system.nu) if problem.du is None else problem.du
    of = {"stage_cost": problem.stage_cost, "terminal_cost": problem.terminal_cost}
    of |= {one.name: one.expression for one in (*problem.path, *problem.terminal)}
    moving, p = ca.vertcat(system.x, system.u, du), problem.parameters
    found = {
        f"{jump} in {name}": None
        for name, expression in of.items()
        for entry in ca.substitute(expression, p.vector, p.values).nz
        for jump in jumps(entry, moving, np.concatenate([sizes.x, sizes.u, sizes.u]))
    }
    return tuple(found)


def jumps(expression: ca.SX, moving: ca.SX, sizes: np.ndarray) -> list[str]:
    """Names of the operations at which a scalar ``expression`` jumps as ``moving`` (n, 1) moves.

    It may use no other symbols. Along straight lines between random points of ``sizes`` (n,), a
    hundredth to a hundred times as large, every place at which an operation of the graph switches
    is found by bisection, and the values on its two sides compared: ``if_else`` that is continuous,
    as Huber's loss is, does not jump. What no line switches is taken to jump.
    """
    found = []
    for name, switch in _switches(expression, moving):
        at = ca.Function("at", [moving], [expression, switch])
        if name not in found and _steps_over(at, sizes):
            found.append(name)
    return found


def _switches(expression: ca.SX, moving: ca.SX) -> Iterator[tuple[str, ca.SX]]:
    """Operations that may jump as ``moving`` moves, and what is constant but where they do."""
    seen: set[int] = set()
    left = [expression]
    while left:
        node = left.pop()
        if node.is_leaf() or node.element_hash() in seen:
            continue
        seen.add(node.element_hash())
        parts = [node.dep(k) for k in range(node.n_dep())]
        left += parts
        op = node.op()
        if (op in _COMPARED or op in _STEPS) and ca.depends_on(node, moving):
            ratio = parts[0] / parts[1] if op in (ca.OP_FMOD, ca.OP_REMAINDER) else ca.SX(0)
            constant = {
                ca.OP_FMOD: ca.floor(ca.fabs(ratio)), ca.OP_REMAINDER: ca.floor(ratio + 0.5),
                ca.OP_COPYSIGN: parts[-1] < 0,
            }  # fmt: skip
            yield _COMPARED.get(op) or _STEPS[op], constant.get(op, node)


def _steps_over(at: ca.Function, sizes: np.ndarray) -> bool:
    rng, crossed = np.random.default_rng(0), False
    for _ in range(_LINES):
        ends = sizes * rng.normal(size=(2, sizes.size)) * 10.0 ** rng.uniform(-2, 2, (2, 1))
        low, high = 0.0, 1.0

        def value(share: float, ends: np.ndarray = ends) -> tuple[float, float]:
            there, switch = at(ends[0] + share * (ends[1] - ends[0]))
            return float(there), float(switch)

        (first, before), (last, after) = value(low), value(high)
        if before == after:
            continue
        for _ in range(_HALVINGS):
            middle = (low + high) / 2
            low, high = (middle, high) if value(middle)[1] == before else (low, middle)
        one, other = value(low)[0], value(high)[0]
        least = _SEEN * (abs(one) + abs(other)) + _ROUNDING * (abs(first) + abs(last))
        crossed = crossed or bool(np.isfinite(least))
        if abs(one - other) > least:
            return True
    return not crossed
