"""Two bodies on a line, pushed together: contact as a stiff spring, or by implicit stepping."""

from __future__ import annotations

import casadi as ca

from dynamics.systems import ContactSystem, Parameter, ParameterTable, lcs, signals

_STATES = "x1 [m]; x2 [m]; v1 [m/s]; v2 [m/s]"


def pushing_system(k: float | None, m: float, c: float, h: float, length: float) -> ContactSystem:
    """One step of ``v+ = c v + (h/m) f``, ``x+ = x + h v+``; u [N] pushes body 1 towards body 2.

    The gap is ``x2 - x1 - length``. With a stiffness ``k`` [N/m] contact is the penalty method
    under semi-implicit integration, ``f = k max(0, -gap(x))``: as a complementarity problem
    ``0 <= lam ⟂ gap(x) + lam/k >= 0``, whose exact law is that spring; lam is a force [N]. Without
    one it is implicit time stepping, ``0 <= lam ⟂ gap(x+) >= 0``.
    """
    rate = h / m
    table = ParameterTable([] if k is None else [Parameter("k", k, "N/m", "stiffness")])
    force = [[-rate * h], [rate * h], [-rate], [rate]]
    row = [-1.0, 1.0, 0.0, 0.0] if k is not None else [-1.0, 1.0, -h * c, h * c]
    return lcs(
        "pushing",
        A=[[1, 0, h * c, 0], [0, 1, 0, h * c], [0, 0, c, 0], [0, 0, 0, c]],
        B=[[rate * h], [0], [rate], [0]],
        C=force,
        D=[row],
        E=[[0.0 if k is not None else -rate * h]],
        F=1 / table["k"] if k is not None else ca.SX(2 * rate * h),
        d=[-length],
        states=signals(_STATES), inputs=signals("u [N]"), contacts=signals("contact [N]"),
        h=h, parameters=table,
    )  # fmt: skip
