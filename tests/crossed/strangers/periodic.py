"""A ball that a spring leg keeps hopping: where does the cycle begin?"""

from dynamics.systems import signals, time_stepping
from ocp.problem.problem import FreeStart, Problem
from problems.parameters import Parameters, quantity, structure, table

name, title = "hop", "A cycle of a hopping mass"


class Params(Parameters):
    m: float = quantity(1.0, "kg", "mass", above=0)
    g: float = quantity(9.81, "m/s^2", "gravity", least=0)
    h: float = quantity(0.05, "s", "step", above=0)
    N: int = structure(8, "steps", least=2)


def build(params):
    p = table(params)
    system = time_stepping(
        name,
        states=signals("z [m]; v [m/s]"),
        inputs=signals("F [N]"),
        contacts=signals("ground [N s]"),
        h=p["h"],
        mass=p["m"],
        impulse=lambda q, v, u: p["h"] * (u - p["m"] * p["g"]),
        distance=lambda q: q,
        parameters=p,
    )
    z = system.x[0]
    return Problem(
        name,
        system,
        params.N,
        stage_cost=(z - 0.2) ** 2 + 1e-4 * system.u**2,
        terminal_cost=0,
        x0=[0.1, 0],
        parameters=p,
        u_lower=-5,
        u_upper=30,
        start=FreeStart([0, -3], [0.5, 3], periodic=(0, 1)),
    )
