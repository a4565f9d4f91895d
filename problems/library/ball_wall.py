"""A ball thrown at a wall with a sharp corner: it flies over or bounces back, so the cost jumps."""

from __future__ import annotations

import casadi as ca

from dynamics.systems import ParameterTable
from problems.parameters import Parameters, quantity
from problems.spec import Citation

name = "ball-wall"
title = "A ball thrown past the corner of a rectangular wall"
citation = Citation("suh2022pathologies", "Pathologies of differentiable simulators, ex. III.6")
equations = r"""
x(t) = v_0 t cos a, quad y(t) = v_0 t sin a - g t^2 \/ 2, quad a = theta + w
f = -x(T), quad "or" -(2 d - x(T)) "where" y < y_"top" "at the wall's face," x = d
"""


class Params(Parameters):
    """Parameters of ``ball-wall``; the defaults are from the authors' public code, except sigma."""

    theta: float = quantity(0.68, "rad", "angle of the throw", above=0, most=1.5)
    v0: float = quantity(5.0, "m/s", "speed of the throw", above=0)
    g: float = quantity(9.81, "m/s^2", "gravity", above=0)
    d: float = quantity(1.475, "m", "distance of the wall's face", above=0)
    top: float = quantity(0.5, "m", "height of the wall")
    T: float = quantity(0.4, "s", "time of flight", above=0)
    sigma: float = quantity(0.02, "rad", "standard deviation of the noise on theta", above=0)


def cost(params: Params, theta: ca.SX, p: ParameterTable) -> ca.SX:
    """Return the cost in closed form: free flight with at most one elastic reflection at the wall."""
    forward = p["v0"] * ca.cos(theta)
    meets = p["d"] / forward
    height = p["v0"] * meets * ca.sin(theta) - p["g"] * meets**2 / 2
    flight = forward * p["T"]
    hits = ca.logic_and(ca.logic_and(forward > 0, meets < p["T"]), height < p["top"])
    return -ca.if_else(hits, 2 * p["d"] - flight, flight)
