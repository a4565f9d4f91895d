"""Open a drawer with a hook; inches, pounds and seconds.

It resembles articulated-object tasks. The hook is the round tip of an arm in the plane above the drawer. It starts
in front of the handle, a peg on the drawer's lip, and can only pull from behind: the tip must go over the peg, down
between peg and front, and back. Doing nothing costs 36. The best-known value is plausible since the path round the peg
and the drawer's travel are fixed by the geometry, and the other path, under the peg, is longer.
"""

import casadi as ca
import numpy as np

from dynamics.systems import signals, time_stepping
from ocp import Problem, Scaling
from problems.parameters import Parameters, quantity, structure, table

name = "drawer-hook"
title = "A hook opens a drawer"


class Params(Parameters):
    """Lengths are in inches, masses in pounds, and forces in lb in/s^2, 386 of which are a pound of weight."""

    drawer: float = quantity(5.0, "lb", "mass of the drawer", above=0)
    hook: float = quantity(1.0, "lb", "mass of the hook", above=0)
    drag: float = quantity(20.0, "lb/s", "drag of the rails", least=0)
    reach: float = quantity(0.6, "in", "radii of peg and tip together", above=0)
    friction: float = quantity(0.2, "1", "Coulomb's coefficient of the tip on the peg", least=0)
    open: float = quantity(6.0, "in", "how far to open", above=0)
    force: float = quantity(200.0, "lb in/s^2", "largest force on the hook", above=0)
    h: float = quantity(0.04, "s", "step size", above=0)
    N: int = structure(50, "number of steps", least=1)


def build(params: Params) -> Problem:
    """Build the problem; the state is the drawer's opening along +x, the hook's position, and their velocities."""
    p = table(params)

    def separation(q: ca.SX) -> ca.SX:
        """Return the vector from the peg, two inches in front of the drawer, to the tip."""
        return q[1:] - ca.vertcat(q[0] + 2, 0)

    def slip(q: ca.SX) -> ca.SX:
        """Return the row of the speed at which the tip slides round the peg."""
        away = separation(q) / ca.norm_2(separation(q))
        return ca.horzcat(away[1], -away[1], away[0])

    system = time_stepping(
        name,
        states=signals("d [in] drawer; x [in] tip; z [in] tip; vd [in/s]; vx [in/s]; vz [in/s]"),
        inputs=signals("fx [lb in/s^2]; fz [lb in/s^2]"),
        contacts=signals("peg [lb in/s]; front [lb in/s]; closed [lb in/s]"),
        h=p["h"],
        mass=ca.diag(ca.vertcat(p["drawer"], p["hook"], p["hook"])),
        impulse=lambda q, v, u: p["h"] * ca.vertcat(0, u),
        damping=ca.diag(ca.vertcat(p["drag"], 0, 0)),
        distance=lambda q: ca.vertcat(ca.norm_2(separation(q)) - p["reach"], q[1] - q[0] - 0.3, q[0]),
        sliding=lambda q: ca.vertcat(slip(q), ca.SX(2, 3)),
        friction=ca.vertcat(p["friction"], 0, 0),
        parameters=p,
    )
    x = system.x
    return Problem(
        name,
        system,
        params.N,
        stage_cost=1e-6 * ca.sumsqr(system.u),
        terminal_cost=(x[0] - p["open"]) ** 2 + 0.01 * ca.sumsqr(x[3:]),
        x0=ca.vertcat(0, 4, 0.1, 0, 0, 0),
        parameters=p,
        u_lower=-p["force"],
        u_upper=p["force"],
        scaling=Scaling(gap=0.5, x=2, u=50),
    )


def reached(params: Params, state: np.ndarray) -> bool:
    """Return whether the drawer is open to within half an inch."""
    return abs(state[0] - params.open) < 0.5
