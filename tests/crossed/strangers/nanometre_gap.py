"""The tip of a microscope over a sample; its distance sensor counts nanometres."""

from dynamics.systems import signals, time_stepping
from ocp.problem.problem import Problem, Scaling
from problems.parameters import Parameters, quantity, structure, table

name, title = "tip", "A tip comes down onto a sample"


class Params(Parameters):
    m: float = quantity(0.2, "kg", "tip and its stage", above=0)
    h: float = quantity(0.05, "s", "step", above=0)
    N: int = structure(8, "steps", least=1)


def build(params):
    p = table(params)
    system = time_stepping(
        name,
        states=signals("z [m]; v [m/s]"),
        inputs=signals("J [N s]"),
        contacts=signals("sample [N s]"),
        h=p["h"],
        mass=p["m"],
        impulse=lambda q, v, u: u,
        distance=lambda q: 1e9 * q,
        parameters=p,
    )
    z, v = system.x[0], system.x[1]
    return Problem(
        name,
        system,
        params.N,
        stage_cost=0.1 * system.u**2,
        parameters=p,
        terminal_cost=10 * (z - 0.01) ** 2 + v**2,
        x0=[0.4, -1.5],
        u_lower=-0.02,
        u_upper=0.02,
        scaling=Scaling(impulse=0.3, gap=0.1),
    )
