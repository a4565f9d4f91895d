"""A disc pushed over a plane by a smaller disc without friction."""

from __future__ import annotations

import casadi as ca
import numpy as np
from pydantic import model_validator

from dynamics.learned.region import Region
from dynamics.systems import quasi_dynamic, signals
from ocp.problem.problem import Problem, Scaling, Scenarios
from problems.drawing import Circle, ContactFrame, Mark, Shape
from problems.parameters import Parameters, pose_problem, quantity, structure, table
from problems.spec import Citation, Golden, smoothed

name = "push-disc"
title = "Pushing a disc in the plane"
citation = Citation("suh2023noising", "Noising data, eq. 13-14, in the plane and frictionless")
equations = """
M / h (o^+ - o) = n lambda, quad h K (a^+ - u) = -n lambda, quad n = (o - a) / norm(o - a)
0 <= lambda perp norm(o - a) - R - r + n dot ((o^+ - o) - (a^+ - a)) >= 0
min sum_(k=0)^(N-1) w_x norm(o_k - o_"goal")^2 + w_(delta u) norm(delta u_k)^2
  + w_"end" norm(o_N - o_"goal")^2
delta u_k = u_k - u_(k-1), quad u_(-1) = a_0, quad norm(u_k)_infinity <= u_"max"
"""
golden = {
    "exact": Golden(
        0.100678475, tried=33, note="a plain Opti script, cold Scholtes homotopy, ends no lower from 36 random guesses"
    ),
    "barrier mu=1e-3": smoothed(0.100609441, tried=11, note="a plain Opti script ends no lower from 18 random guesses"),
}


class Params(Parameters):
    """Parameters of ``push-disc``; with ``scenarios`` > 1 the object's start is uncertain."""

    M: float = quantity(1.0, "kg", "mass of the object", above=0)
    K: float = quantity(50.0, "N/m", "stiffness of the actuator", above=0)
    h: float = quantity(0.1, "s", "step size", above=0)
    N: int = structure(20, "number of steps", least=1)
    R: float = quantity(0.5, "m", "radius of the object", above=0)
    r: float = quantity(0.1, "m", "radius of the pusher", above=0)
    ox0: float = quantity(0.0, "m", "start of the object, x")
    oy0: float = quantity(0.0, "m", "start of the object, y")
    ax0: float = quantity(-1.0, "m", "start of the pusher, x")
    ay0: float = quantity(0.2, "m", "start of the pusher, y")
    goal_x: float = quantity(1.0, "m", "goal of the object, x")
    goal_y: float = quantity(0.5, "m", "goal of the object, y")
    w_x: float = quantity(0.01, "1/m^2", "stage weight of the distance to the goal", least=0)
    w_du: float = quantity(0.1, "1/m^2", "stage weight of the input's increments", least=0)
    w_end: float = quantity(10.0, "1/m^2", "terminal weight of the distance to the goal", least=0)
    u_max: float = quantity(3.0, "m", "largest commanded coordinate", above=0)
    scenarios: int = structure(1, "number of initial states", least=1, most=1000)
    scenario_std: float = structure(0.03, "standard deviation of the object's start over scenarios", unit="m")
    scenario_seed: int = structure(0, "seed of the scenarios", most=2**31 - 1)

    @model_validator(mode="after")
    def _apart(self) -> Params:
        distance = float(np.hypot(self.ox0 - self.ax0, self.oy0 - self.ay0))
        if distance < self.R + self.r:
            raise ValueError(
                f"the pusher starts inside the object: their centres are {distance:g} m apart,"
                f" which must be at least R + r = {self.R + self.r:g} m"
            )
        return self


def build(params: Params) -> Problem:
    """Return the problem with steps (push-disc.1) of Suh et al. (2023), eq. 13; the gap (push-disc.2) is linearised.

    u is the commanded position of the pusher [m], lam an impulse [N s].
    """
    p = table(params)

    def distance(q: ca.SX) -> ca.SX:
        return ca.norm_2(q[:2] - q[2:]) - p["R"] - p["r"]

    system = quasi_dynamic(
        name,
        states=signals("ox [m] object; oy [m] object; ax [m] pusher; ay [m] pusher"),
        inputs=signals("ux [m] commanded pusher; uy [m] commanded pusher"),
        contacts=signals("push [N s] impulse on the object"),
        h=p["h"],
        mass=p["M"] * ca.SX.eye(2),
        stiffness=p["K"] * ca.SX.eye(2),
        distance=distance,
        linearised=True,
        parameters=p,
    )
    du = ca.SX.sym("du", 2)
    squared_distance = ca.sumsqr(system.x[:2] - ca.vertcat(p["goal_x"], p["goal_y"]))
    std = params.scenario_std
    return pose_problem(
        params,
        system,
        stage_cost=p["w_x"] * squared_distance + p["w_du"] * ca.sumsqr(du),
        terminal_cost=p["w_end"] * squared_distance,
        x0=ca.vertcat(p["ox0"], p["oy0"], p["ax0"], p["ay0"]),
        du=du,
        u_before=ca.vertcat(p["ax0"], p["ay0"]),
        scenarios=Scenarios(params.scenarios, (std, std, 0.0, 0.0), params.scenario_seed),
        scaling=Scaling(impulse=0.5, gap=0.1, x=0.5, u=0.5),
    )


def region(params: Params) -> Region:
    """Return the region of sampled transitions: 0.5 m around a line on which pusher and object move together."""
    start = np.array([params.ox0, params.oy0, params.ax0, params.ay0])
    goal = np.array([params.goal_x, params.goal_y])
    goal = np.concatenate([goal, start[2:] + goal - start[:2]])
    ends = np.reshape([start, goal], (4, 2))
    x, y = zip((ends.min(axis=0) - 0.5).tolist(), (ends.max(axis=0) + 0.5).tolist(), strict=True)
    return Region(
        {"ox": x, "oy": y, "ax": x, "ay": y},
        {"ux": (-0.5, 0.5), "uy": (-0.5, 0.5)},
        start.tolist(),
        goal.tolist(),
        spread=(0.2,) * 4,
        around={"ux": "ax", "uy": "ay"},
    )


def draw(params: Params, state: np.ndarray) -> list[Shape]:
    """Draw object, pusher and goal."""
    ox, oy, ax, ay = (float(value) for value in state)
    return [Mark(params.goal_x, params.goal_y, "goal"), Circle(ox, oy, params.R), Circle(ax, ay, params.r, "actuator")]


def frames(params: Params, state: np.ndarray) -> list[ContactFrame]:
    """Return the contact frame of the pusher on the object, along the line of centres."""
    normal = np.asarray(state[:2]) - np.asarray(state[2:])
    nx, ny = (float(value) for value in normal / np.linalg.norm(normal))
    return [ContactFrame(float(state[0]) - params.R * nx, float(state[1]) - params.R * ny, nx, ny)]
