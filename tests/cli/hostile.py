"""A problem whose names are mathematics, markup and formulas, for the tests of pages."""

import casadi as ca

from dynamics.systems import signals, time_stepping
from ocp.problem.problem import Problem, Scaling
from problems.drawing import Rectangle, Wall
from problems.parameters import Parameters, quantity, table

name, title = "hostile", "A $mass_{ #that <b>brakes</b> \\alpha"


class Params(Parameters):
    """A mass before a wall."""

    goal: float = quantity(0.2, "m", "where $to_{ rest", above=0)


def build(params: Params) -> Problem:
    """Push a mass against a wall at x = 0."""
    p = table(params)
    system = time_stepping(
        name,
        states=signals("x$a_{$ [m] posi$tion_{; =v<i> [m/s] velocity"),
        inputs=signals("@u$_{ [N s] impulse"),
        contacts=signals("-wa$ll_{^$ [N s] impulse"),
        h=0.1,
        mass=1.0,
        impulse=lambda q, v, u: u,
        distance=lambda q: q,
        parameters=p,
    )
    x, v = system.x[0], system.x[1]
    return Problem(
        name,
        system,
        N=8,
        stage_cost=0.1 * system.u**2,
        parameters=p,
        terminal_cost=10 * (x - p["goal"]) ** 2 + 10 * v**2,
        x0=ca.vertcat(0.5, -1.0),
        scaling=Scaling(impulse=1.0, gap=0.1),
    )


def draw(params, state):
    """The wall and the mass."""
    return [Wall(0, 0, 1, 0), Rectangle(float(state[0]) + 0.05, 0, 0.1, 0.1)]
