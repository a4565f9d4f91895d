"""Push the second of two blocks in a row to its mark by pushing only the first; centimetres, grams and seconds.

It resembles pushing a line of parts: a slide pushes the near block, which crosses a gap before it meets the far one.
Both are on a belt with drag, less for the far one. The slide must be back at its start at the end, so that it stops
pushing early. The far block does not move until the near one has crossed the gap. The best-known value is plausible
since on a line the contact sequence is unique, slide, near, far, and only its timing is left to optimise.
"""

import casadi as ca
import numpy as np

from dynamics.systems import signals, time_stepping
from ocp import Problem, Scaling
from problems.parameters import Parameters, quantity, structure, table

name = "two-blocks"
title = "Two blocks in a row with a gap"


class Params(Parameters):
    """Blocks are 10 cm wide; positions are those of their centres."""

    near: float = quantity(400.0, "g", "mass of the near block", above=0)
    far: float = quantity(250.0, "g", "mass of the far block", above=0)
    slide: float = quantity(300.0, "g", "mass of the slide", above=0)
    drag: float = quantity(800.0, "g/s", "drag of the belt on the near block", least=0)
    mark: float = quantity(75.0, "cm", "where the far block must stop")
    force: float = quantity(4e5, "g cm/s^2", "largest force on the slide", above=0)
    h: float = quantity(0.04, "s", "step size", above=0)
    N: int = structure(40, "number of steps", least=1)


def build(params: Params) -> Problem:
    """Build the problem; the state is near block, far block, slide, and their velocities."""
    p = table(params)
    system = time_stepping(
        name,
        states=signals("near [cm]; far [cm]; slide [cm]; v_near [cm/s]; v_far [cm/s]; v_slide [cm/s]"),
        inputs=signals("f [g cm/s^2] on the slide"),
        contacts=signals("push [g cm/s]; knock [g cm/s]"),
        h=p["h"],
        mass=ca.diag(ca.vertcat(p["near"], p["far"], p["slide"])),
        impulse=lambda q, v, u: p["h"] * ca.vertcat(0, 0, u),
        damping=ca.diag(ca.vertcat(p["drag"], p["drag"] / 4, 0)),
        distance=lambda q: ca.vertcat(q[0] - q[2] - 5, q[1] - q[0] - 10),
        parameters=p,
    )
    x = system.x
    return Problem(
        name,
        system,
        params.N,
        stage_cost=1e-11 * system.u**2,
        terminal_cost=0.01 * (x[1] - p["mark"]) ** 2 + 0.002 * x[2] ** 2 + 0.001 * ca.sumsqr(x[4:]),
        x0=ca.vertcat(10, 40, 0, 0, 0, 0),
        parameters=p,
        u_lower=-p["force"],
        u_upper=p["force"],
        scaling=Scaling(gap=5, x=20, u=1e5),
    )


def reached(params: Params, state: np.ndarray) -> bool:
    """Return whether the far block is near its mark."""
    return abs(state[1] - params.mark) < 8
