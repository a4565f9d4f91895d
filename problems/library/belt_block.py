"""A block dragged by a belt: relaxed friction acts on a body with inertia."""

from __future__ import annotations

import casadi as ca

from dynamics.systems import ParameterTable
from problems.parameters import Parameters, quantity, structure
from problems.spec import Citation

name = "belt-block"
title = "A block dragged by a belt, with friction relaxed within a slip tolerance"
citation = Citation("suh2022pathologies", "Pathologies of differentiable simulators, fig. 3, left")
equations = r"""
m (v^+ - v) = h F macron(H)_nu (b - v^+), quad macron(H)_nu (t) = "clip"(2 t \/ nu, -1, 1), quad
  b = theta + w
f = m v_N \/ (N h F): "the impulse on the block as a share of the largest, from rest"
"""


class Params(Parameters):
    """Parameters of ``belt-block``; the defaults are our choice, since the paper shows only a drawing."""

    theta: float = quantity(0.0, "m/s", "velocity of the belt")
    nu: float = quantity(0.01, "m/s", "slip tolerance", above=0)
    m: float = quantity(100.0, "kg", "mass of the block", above=0)
    friction_force: float = quantity(5.0, "N", "largest friction force", above=0)
    h: float = quantity(0.01, "s", "step size", above=0)
    N: int = structure(10, "number of steps", least=1, most=1000)
    sigma: float = quantity(0.1, "m/s", "standard deviation of the noise on theta", above=0)


def cost(params: Params, theta: ca.SX, p: ParameterTable) -> ca.SX:
    """Return the block's impulse relative to the largest, after steps implicit in the sliding velocity.

    The steps are stable for every nu: within the tolerance ``v+ = (v + c b)/(1 + c)`` with
    ``c = 2 h F/(m nu)``, otherwise friction is at its limit. A block as fast as the belt does not
    slide: for nu = 0 the impulse of N steps is ``clip(m b, +-N h F)``, of slope at most m.
    """
    v = ca.SX(0)
    kick = p["h"] * p["friction_force"] / p["m"]
    c = 2 * kick / p["nu"]
    for _ in range(params.N):
        slip = theta - v
        sticks = ca.fabs(slip) <= (1 + c) * p["nu"] / 2
        v = ca.if_else(sticks, v + slip * c / (1 + c), v + kick * ca.sign(slip))
    return v / (params.N * kick)
