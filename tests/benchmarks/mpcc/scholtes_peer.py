"""A plain Scholtes loop as a user would write it: one NLP, a decreasing bound on the products."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from ocp.mpcc import MPCC

FIRST, FACTOR, LAST = 1.0, 0.1, 1e-8
_OPTIONS = {
    "print_time": False,
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
    "ipopt.max_iter": 1000,
    "ipopt.tol": 1e-8,
}
_WARM = {
    "ipopt.warm_start_init_point": "yes",
    "ipopt.warm_start_bound_push": 1e-8,
    "ipopt.warm_start_bound_frac": 1e-8,
    "ipopt.warm_start_slack_bound_push": 1e-8,
    "ipopt.warm_start_slack_bound_frac": 1e-8,
    "ipopt.warm_start_mult_bound_push": 1e-8,
    "ipopt.mu_init": 1e-5,
}


@dataclass(frozen=True)
class PeerAnswer:
    """Result of the loop: x (n,), its cost, and whether every stage converged."""

    x: np.ndarray
    f: float
    converged: bool
    iterations: int


def solve(mpcc: MPCC, start: np.ndarray) -> PeerAnswer:
    """Minimise subject to ``G, H >= 0`` and ``G H <= t``, t from 1 down to 1e-8, with warm starts.

    Sides of pairs that are not entries of x have a slack, since derivatives of products of long
    expressions are several times as expensive.
    """
    sides, rows, free = [], [mpcc.g], [mpcc.x]
    lower, upper = (list(ends) for ends in (mpcc.x_bounds[0], mpcc.x_bounds[1]))
    g_lower, g_upper = (list(ends) for ends in mpcc.g_bounds)
    given = ca.Function("sides", [mpcc.x], [mpcc.G, mpcc.H])
    values = [np.array(v).ravel() for v in given(start)]
    begin = list(start)
    for label, side, value in zip("GH", (mpcc.G, mpcc.H), values, strict=True):
        slack = ca.SX.sym(label, side.numel())
        for i in range(side.numel()):
            if side[i].is_symbolic():
                slack[i] = side[i]
                rows.append(side[i])
                g_lower.append(0.0)
                g_upper.append(np.inf)
            else:
                free.append(slack[i])
                rows.append(side[i] - slack[i])
                g_lower.append(0.0)
                g_upper.append(0.0)
                lower.append(0.0)
                upper.append(np.inf)
                begin.append(max(value[i], 0.0))
        sides.append(slack)
    t = ca.SX.sym("t")
    g = ca.vertcat(*rows, sides[0] * sides[1] - t)
    m = mpcc.G.numel()
    nlp = {"x": ca.vertcat(*free), "p": t, "f": mpcc.f, "g": g}
    bounds = {
        "lbx": lower,
        "ubx": upper,
        "lbg": g_lower + [-np.inf] * m,
        "ubg": g_upper + [0.0] * m,
    }
    cold = ca.nlpsol("cold", "ipopt", nlp, _OPTIONS)
    warm = ca.nlpsol("warm", "ipopt", nlp, {**_OPTIONS, **_WARM})
    return _loop(cold, warm, bounds, np.array(begin), mpcc.x.numel())


def _loop(
    cold: ca.Function, warm: ca.Function, bounds: dict[str, list[float]], begin: np.ndarray, n: int
) -> PeerAnswer:
    point, solver, t, iterations = {"x0": begin}, cold, FIRST, 0
    good = True
    while True:
        found = solver(p=t, **point, **bounds)
        stats = solver.stats()
        iterations += int(stats.get("iter_count", 0))
        good = bool(stats["success"])
        if t <= LAST:
            break
        t = max(FACTOR * t, LAST)
        if good:
            point = {"x0": found["x"], "lam_x0": found["lam_x"], "lam_g0": found["lam_g"]}
            solver = warm
        else:
            point, solver = {"x0": found["x"]}, cold
    return PeerAnswer(np.array(found["x"]).ravel()[:n], float(found["f"]), good, iterations)
