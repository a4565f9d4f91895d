"""Convex QPs for tests, independent of the workbench."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np

_FEASIBLE = 1e-8
"""Feasibility tolerance, ten times the rounding error; with multipliers of order one it changes costs as little."""


def convex(x: ca.SX, f: ca.SX, g: ca.SX) -> Callable[..., float]:
    """Return a function that solves ``min f(x)``, ``low <= x <= high, g_low <= g(x) <= g_high``; inf if infeasible.

    The bounds are broadcast. A solution counts only if it satisfies all constraints to 1e-8, whatever
    the solver reports; its cost is ``f`` as written, since the solver's expanded quadratic cancels
    for unstable motion.
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
