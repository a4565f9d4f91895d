"""Where costs and constraints jump: operations whose value does, and derivatives do not see it."""

from __future__ import annotations

from functools import lru_cache

import casadi as ca
import numpy as np

from ocp.problem import Problem

_SWITCHES = {
    ca.OP_LT: "<", ca.OP_LE: "<=", ca.OP_EQ: "==", ca.OP_NE: "!=", ca.OP_FLOOR: "floor",
    ca.OP_CEIL: "ceil", ca.OP_SIGN: "sign", ca.OP_FMOD: "fmod", ca.OP_REMAINDER: "remainder",
    ca.OP_COPYSIGN: "copysign",
}  # fmt: skip
_SAWS = ("fmod", "remainder", "copysign")
"""Those that are not constant between their jumps; they are taken to jump wherever they stand."""
_LINES, _HALVINGS = 64, 60
_SEEN, _ROUNDING = 1e-9, 1e-12
"""What counts as a jump, of the values beside it, and of those at the ends of the line."""


@lru_cache(maxsize=16)
def jumps_of(problem: Problem) -> tuple[str, ...]:
    """Operations at which costs or constraints jump, ``floor in stage_cost`` and the like."""
    system, sizes = problem.system, problem.scales
    du = ca.SX.sym("du", system.nu) if problem.du is None else problem.du
    of = {"stage_cost": problem.stage_cost, "terminal_cost": problem.terminal_cost}
    of |= {one.name: one.expression for one in (*problem.path, *problem.terminal)}
    moving, p = ca.vertcat(system.x, system.u, du), problem.parameters
    return tuple(dict.fromkeys(
        f"{jump} in {name}"
        for name, expression in of.items()
        for entry in ca.substitute(expression, p.vector, p.values).nz
        for jump in jumps(entry, moving, np.concatenate([sizes.x, sizes.u, sizes.u]))
    ))  # fmt: skip


def jumps(expression: ca.SX, moving: ca.SX, sizes: np.ndarray) -> list[str]:
    """Names of the operations at which a scalar ``expression`` jumps as ``moving`` (n, 1) moves.

    It may use no other symbols. On straight lines between random points of ``sizes`` (n,), a
    hundredth to a hundred times as large, a place where an operation of the graph switches is found
    by bisection, and the values on its two sides compared: ``if_else`` that is continuous, as
    Huber's loss is, does not jump. What no line switches is taken to jump.
    """
    found, seen, left = [], set(), [expression]
    while left:
        node = left.pop()
        if node.is_leaf() or node.element_hash() in seen:
            continue
        seen.add(node.element_hash())
        left += [node.dep(k) for k in range(node.n_dep())]
        name = _SWITCHES.get(node.op(), "")
        if name and name not in found and ca.depends_on(node, moving):
            at = ca.Function("at", [moving], [expression, node])
            found += [name] if name in _SAWS or _steps_over(at, sizes) else []
    return found


def _steps_over(at: ca.Function, sizes: np.ndarray) -> bool:
    rng, crossed = np.random.default_rng(0), False
    for _ in range(_LINES):
        low, high = sizes * rng.normal(size=(2, sizes.size)) * 10.0 ** rng.uniform(-2, 2, (2, 1))
        ends, before = [abs(float(at(point)[0])) for point in (low, high)], at(low)[1]
        if at(high)[1] == before:
            continue
        for _ in range(_HALVINGS):
            middle = (low + high) / 2
            low, high = (middle, high) if at(middle)[1] == before else (low, middle)
        one, other = float(at(low)[0]), float(at(high)[0])
        least = _SEEN * (abs(one) + abs(other)) + _ROUNDING * sum(ends)
        crossed = crossed or bool(np.isfinite(least))
        if abs(one - other) > least:
            return True
    return not crossed
