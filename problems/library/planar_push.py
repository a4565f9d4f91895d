"""A box pushed over a plane by a disc, with friction between them."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np
from pydantic import model_validator

from dynamics.learned.region import Region
from dynamics.systems import quasi_dynamic, shapes, signals
from ocp.problem.problem import Constraint, Problem, Scaling, Scenarios
from problems.drawing import Circle, ContactFrame, Rectangle, Shape
from problems.parameters import Parameters, choice, friction_of, pose_problem, quantity, structure, table
from problems.spec import Citation, Golden, smoothed

name = "planar-push"
title = "Pushing a box in the plane, with friction"
citation = Citation("suh2023noising", "Noising data, sec. V-B, planar pushing, and its code")
equations = """
"box" o = (x, y, theta), "pusher" a, "input" u: "where the pusher is told to be"
M / h delta q_u = (J_(n u) + nu J_(t u))^top lambda_+ + (J_(n u) - nu J_(t u))^top lambda_-, quad
  M = diag(m, m, I)
h K (a^+ - u) = (J_(n a) + nu J_(t a))^top lambda_+ + (J_(n a) - nu J_(t a))^top lambda_-
0 <= lambda_plus.minus perp phi + (J_n plus.minus nu J_t) delta q >= 0, quad
  nu "the coefficient of friction"
phi "from the disc's rim to the box's side", quad norm(o)_w^2 = w_x (x^2 + y^2) + w_"angle" theta^2
min sum_(k=0)^(N-1) norm(o_k - o_"goal")_w^2 + w_a norm(a_k - a_"rest")^2
  + w_(delta u) norm(delta u_k)^2
  + w_"end" (norm(o_N - o_"goal")_w^2 + w_a norm(a_N - a_"rest")^2)
delta u_k = u_k - u_(k-1), quad u_(-1) = a_0, quad norm(u_k - a_k)_infinity <= "reach"
"""
golden = {"exact": Golden(120.918554915, tried=33), "barrier mu=1e-3": smoothed(120.603713118, tried=11)}


class Params(Parameters):
    """Parameters of ``planar-push``; with ``scenarios`` > 1 the box's start is uncertain."""

    m: float = quantity(5.0, "kg", "mass of the box", above=0)
    inertia: float = quantity(0.16667, "kg m^2", "inertia of the box", above=0)
    side: float = quantity(0.999, "m", "side of the box", above=0)
    r: float = quantity(0.1, "m", "radius of the pusher", above=0)
    K: float = quantity(100.0, "N/m", "stiffness of the actuator", above=0)
    friction: float = quantity(2 / 3, "1", "Coulomb's coefficient; 0: frictionless", least=0)
    h: float = quantity(0.1, "s", "step size", above=0)
    N: int = structure(20, "number of steps", least=1)
    gap: str = choice(("linearised", "true"), "phi at the next state: linearised, as published, or exact")
    ox0: float = quantity(0.0, "m", "start of the box, x")
    oy0: float = quantity(0.5, "m", "start of the box, y")
    angle0: float = quantity(0.0, "rad", "start of the box, angle")
    ax0: float = quantity(0.0, "m", "start of the pusher, x")
    ay0: float = quantity(-0.2, "m", "start of the pusher, y")
    goal_x: float = quantity(0.5, "m", "goal of the box, x")
    goal_y: float = quantity(1.0, "m", "goal of the box, y")
    goal_angle: float = quantity(-math.pi / 4, "rad", "goal of the box, angle")
    rest_x: float = quantity(0.0, "m", "preferred position of the pusher, x")
    rest_y: float = quantity(0.0, "m", "preferred position of the pusher, y")
    w_x: float = quantity(20.0, "1/m^2", "weight of the box's distance to the goal", least=0)
    w_angle: float = quantity(30.0, "1/rad^2", "weight of the box's angle from the goal", least=0)
    w_a: float = quantity(1e-3, "1/m^2", "weight of the pusher's distance to its preferred position", least=0)
    w_du: float = quantity(10.0, "1/m^2", "stage weight of the input's increments", least=0)
    w_end: float = quantity(100.0, "1", "terminal weight, relative to the stage weights", least=0)
    reach: float = quantity(0.2, "m", "largest |u - a|, componentwise", above=0)
    scenarios: int = structure(1, "number of initial states", least=1, most=1000)
    scenario_std: float = structure(0.02, "standard deviation of the box's start over scenarios", unit="m")
    scenario_angle_std: float = structure(0.05, "standard deviation of its angle over scenarios", unit="rad")
    scenario_seed: int = structure(0, "seed of the scenarios", most=2**31 - 1)

    @model_validator(mode="after")
    def _apart(self) -> Params:
        start = self._distance(self.ox0, self.oy0, self.angle0)
        if start < 0:
            raise ValueError(
                f"the pusher starts {-start:.3g} m inside the box; move ax0, ay0 or ox0, oy0 so"
                f" that the box's side is at least r = {self.r:g} m from the pusher's middle"
            )
        goal = self._distance(self.goal_x, self.goal_y, self.goal_angle)
        if goal < 0:
            raise ValueError(
                f"the box's goal overlaps the pusher, where it starts, by {-goal:.3g} m; move"
                " goal_x, goal_y away from ax0, ay0, or the pusher to another side"
            )
        return self

    def _distance(self, x: float, y: float, angle: float) -> float:
        """Return the signed distance [m] between the pusher at its start and the box in a given pose."""
        state = ca.SX([x, y, angle, self.ax0, self.ay0])
        return float(_touch(state, ca.SX(self.side), ca.SX(self.r)).phi)


def _touch(q: ca.SX, side: ca.SX, r: ca.SX) -> shapes.Contact:
    pusher, box = shapes.Pose(q[3:], ca.SX(0)), shapes.Pose(q[:2], -q[2])
    shape = shapes.Box((side / 2, side / 2))
    return shapes.Contact.between(shapes.Disc(r), pusher, shape, box)


def build(params: Params) -> Problem:
    """Return the problem whose quasi-dynamic steps (planar-push.2) are those of Suh et al. (2023), eq. 13.

    u is the commanded position of the pusher [m], and lam the impulses [N s] along the two edges of the
    friction cone. A problem without friction has one impulse and no parameter ``friction``.
    """
    p, friction = friction_of(table(params))

    system = quasi_dynamic(
        name,
        states=signals("ox [m] box; oy [m] box; theta [rad] box, anticlockwise; ax [m] pusher; ay [m] pusher"),
        inputs=signals("ux [m] commanded pusher; uy [m] commanded pusher"),
        contacts=signals("push [N s] impulse on the box"),
        h=p["h"],
        mass=ca.diag(ca.vertcat(p["m"], p["m"], p["inertia"])),
        stiffness=p["K"] * ca.SX.eye(2),
        distance=lambda q: _touch(q, p["side"], p["r"]).phi,
        sliding=lambda q: _touch(q, p["side"], p["r"]).jacobians(q)[1],
        friction=friction,
        linearised=params.gap == "linearised",
        parameters=p,
    )
    x, du = system.x, ca.SX.sym("du", 2)
    error = x - ca.vertcat(p["goal_x"], p["goal_y"], p["goal_angle"], p["rest_x"], p["rest_y"])
    weights = ca.vertcat(p["w_x"], p["w_x"], p["w_angle"], p["w_a"], p["w_a"])
    state_cost = ca.dot(weights, error**2)
    std = params.scenario_std
    return pose_problem(
        params,
        system,
        stage_cost=state_cost + p["w_du"] * ca.sumsqr(du),
        terminal_cost=p["w_end"] * state_cost,
        x0=ca.vertcat(p["ox0"], p["oy0"], p["angle0"], p["ax0"], p["ay0"]),
        du=du,
        u_before=ca.vertcat(p["ax0"], p["ay0"]),
        path=[Constraint("reach", system.u - x[3:], -p["reach"], p["reach"])],
        scenarios=Scenarios(params.scenarios, (std, std, params.scenario_angle_std, 0.0, 0.0), params.scenario_seed),
        scaling=Scaling(impulse=1.0, gap=0.1, x=0.5, u=0.5),
    )


def region(params: Params) -> Region:
    """Return the region of sampled transitions: fixed intervals, and a line on which pusher and box move together."""
    start = (params.ox0, params.oy0, params.angle0, params.ax0, params.ay0)
    goal = (params.goal_x, params.goal_y, params.goal_angle)
    pusher_goal = (params.ax0 + goal[0] - params.ox0, params.ay0 + goal[1] - params.oy0)
    hand, reach = (-1.5, 1.5), (-params.reach, params.reach)
    return Region(
        {"ox": (-1, 1), "oy": (-1, 1), "theta": (-math.pi, math.pi), "ax": hand, "ay": hand},
        {"ux": reach, "uy": reach},
        start,
        (*goal, *pusher_goal),
        spread=(0.1, 0.1, 0.2, 0.25, 0.25),
        around={"ux": "ax", "uy": "ay"},
    )


def draw(params: Params, state: np.ndarray) -> list[Shape]:
    """Draw box, pusher and goal."""
    ox, oy, angle, ax, ay = (float(value) for value in state)
    side = params.side
    return [
        Rectangle(params.goal_x, params.goal_y, side, side, params.goal_angle, "goal"),
        Rectangle(ox, oy, side, side, angle),
        Circle(ax, ay, params.r, "actuator"),
    ]


def frames(params: Params, state: np.ndarray) -> list[ContactFrame]:
    """Return the contact frame at the box's point nearest to the pusher, with the normal into the box."""
    touch = _touch(ca.SX(ca.DM(state)), ca.SX(params.side), ca.SX(params.r))
    x, y = (float(value) for value in ca.vertsplit(touch.point - touch.phi * touch.normal))
    nx, ny = (-float(value) for value in ca.vertsplit(touch.normal))
    return [ContactFrame(x, y, nx, ny, params.friction)]
