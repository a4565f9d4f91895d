"""An arm of an MJCF file taps on a bench."""

from pathlib import Path

from ocp.problem.problem import Problem
from problems import robots
from problems.parameters import Parameters, quantity, structure, table

name, title = "swinging-arm", "An arm of a file"
robot = robots.load(Path(__file__).parent / "swinging_arm.xml")


class Params(Parameters):
    goal: float = quantity(0.9, "rad", "angle of the shoulder")
    h: float = quantity(0.03, "s", "step", above=0)
    N: int = structure(5, "steps", least=1)


def build(params):
    p = table(params)
    system = robot.machine.system(name, p, h=p["h"], friction=robot.coefficients)
    low, high = robot.controls.T
    return Problem(
        name,
        system,
        params.N,
        stage_cost=0.1 * system.u**2,
        parameters=p,
        terminal_cost=10 * (system.x[0] - p["goal"]) ** 2,
        x0=[0.2, 0],
        u_lower=low,
        u_upper=high,
    )
