"""Convex QPs of the tests' own writing, with nothing of the workbench in them."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np

_FEASIBLE = 1e-8
"""Ten times what rounding leaves; at multipliers of order one it moves a cost by as little."""


def convex(x: ca.SX, f: ca.SX, g: ca.SX) -> Callable[..., float]:
    """``min f(x)`` over ``low <= x <= high, g_low <= g(x) <= g_high``, inf where nothing is.

    The ends are broadcast. An answer counts only where it keeps all constraints to 1e-8, whatever
    the solver says of it; its cost is that of ``f`` as written, for the solver's expanded quadratic
    cancels where the motion is unstable.
    """
    options = {"error_on_fail": False, "printLevel": "none"}
    cost = ca.Function("cost", [x], [f])
    solver = ca.qpsol("convex", "qpoases", {"x": x, "f": f, "g": g}, options)

    def least(low, high, g_low, g_high) -> float:
        found = solver(lbx=low, ubx=high, lbg=g_low, ubg=g_high)
        at, rows = (np.array(found[key]).ravel() for key in ("x", "g"))
        off = max(np.max(low - at), np.max(at - high), np.max(g_low - rows), np.max(rows - g_high))
        return float(cost(at)) if solver.stats()["success"] and off < _FEASIBLE else np.inf

    return least
