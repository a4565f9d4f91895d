"""A ball thrown at a wall with a sharp corner: over it or back, and nothing between."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from dynamics.systems import Parameter, ParameterTable, Signal
from ocp.gradients.objective import StaticObjective
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
    """Parameters of ``ball-wall``, from the authors' public code but for sigma."""

    theta: float = quantity(0.68, "rad", "decision, angle of the throw", above=0, most=1.5)
    v0: float = quantity(5.0, "m/s", "speed of the throw", above=0)
    g: float = quantity(9.81, "m/s^2", "gravity", above=0)
    d: float = quantity(1.475, "m", "distance of the wall's face", above=0)
    top: float = quantity(0.5, "m", "height of the wall")
    T: float = quantity(0.4, "s", "time of flight", above=0)
    sigma: float = quantity(0.02, "rad", "standard deviation of the noise on theta", above=0)


def build(params: Params, **engine: Any) -> StaticObjective:
    """Free flight and one elastic reflection, in closed form: no time step blurs the corner."""
    fields = {"v0": "m/s", "g": "m/s^2", "d": "m", "top": "m", "T": "s"}
    p = ParameterTable(Parameter(k, getattr(params, k), unit) for k, unit in fields.items())
    angle = ca.SX.sym("theta")
    forward = p["v0"] * ca.cos(angle)
    meets = p["d"] / forward
    height = p["v0"] * meets * ca.sin(angle) - p["g"] * meets**2 / 2
    flight = forward * p["T"]
    hits = ca.logic_and(ca.logic_and(forward > 0, meets < p["T"]), height < p["top"])
    return StaticObjective(
        name,
        (Signal("theta", "rad", "angle of the throw"),),
        angle,
        -ca.if_else(hits, 2 * p["d"] - flight, flight),
        np.array([params.theta]),
        p,
        **engine,
    )
