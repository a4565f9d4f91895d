"""A hopper on a vertical rail that jumps as high as possible, with a bang-bang optimum in closed form."""

from __future__ import annotations

import casadi as ca
import numpy as np
from pydantic import model_validator

from dynamics.systems import signals, time_stepping
from ocp.problem.problem import Problem, Scaling
from problems.drawing import Circle, ContactFrame, Rectangle, Segment, Shape, Wall
from problems.parameters import Parameters, pose_problem, quantity, structure, table
from problems.spec import Citation, Golden

name = "hopper-1d"
title = "A one-dimensional hopper that jumps"
citation = Citation("bryson1975applied", "The double integrator's bang-bang optimum, with a foot")
axes = ("x [m]", "z [m]")
equations = """
m_b (v_b^+ - v_b) = h (u - m_b g) + lambda_"short" - lambda_"long", quad z^+ = z + h v^+
m_f (v_f^+ - v_f) = h (-u - m_f g) + lambda_"foot" - lambda_"short" + lambda_"long"
0 <= lambda_"foot" perp z_f^+ >= 0, quad l = z_b - z_f "the leg"
0 <= lambda_"short" perp l^+ - l_"min" >= 0, quad 0 <= lambda_"long" perp l_"max" - l^+ >= 0
max z_(c,N) - z_(c,0) - w_v v_(c,N)^2, quad abs(u) <= u_"max": "as high as can be, at the apex"
"only the ground can lift the centre of mass" z_c
"optimum for large" w_v: "force" u_"max" "for a time" t = T (M g) / (u_"max" + m_f g) "then flight"
z_(c,N) - z_(c,0) = (u_"max" - m_b g) / (2 M) t T, quad M = m_b + m_f
"""
golden = {"exact": Golden(-0.6146875, tried=33, independent="the closed form of the bang-bang optimum")}


class Params(Parameters):
    """Parameters of ``hopper-1d``; by default stance and flight each take half of the time."""

    mb: float = quantity(4.0, "kg", "mass of the body", above=0)
    mf: float = quantity(1.0, "kg", "mass of the foot", above=0)
    g: float = quantity(9.81, "m/s^2", "gravity", above=0)
    h: float = quantity(0.025, "s", "step size", above=0)
    N: int = structure(20, "number of steps", least=2)
    leg0: float = quantity(0.4, "m", "length of the leg at the start", above=0)
    leg_min: float = quantity(0.2, "m", "shortest leg", above=0)
    leg_max: float = quantity(1.0, "m", "longest leg", above=0)
    w_v: float = quantity(10.0, "s^2/m", "weight of the velocity at the end", above=0)
    u_max: float = quantity(88.29, "N", "largest force of the leg", above=0)

    @model_validator(mode="after")
    def _can_stand(self) -> Params:
        if not self.leg_min <= self.leg0 <= self.leg_max:
            raise ValueError(
                f"the leg starts at leg0 = {self.leg0:g} m, which must lie between leg_min ="
                f" {self.leg_min:g} m and leg_max = {self.leg_max:g} m"
            )
        if self.u_max <= self.mb * self.g:
            raise ValueError(
                f"the leg cannot lift the body: u_max = {self.u_max:g} N must be more than its"
                f" weight mb g = {self.mb * self.g:g} N"
            )
        return self


def build(params: Params) -> Problem:
    """Return the problem with steps of body (hopper-1d.1) and foot (hopper-1d.2), and stops of the leg (hopper-1d.4).

    lam are impulses [N s]. In flight the leg's force is not unique, since it does not affect the
    centre of mass, on which the cost depends.
    """
    p = table(params)
    mb, mf, h = p["mb"], p["mf"], p["h"]
    system = time_stepping(
        name,
        states=signals("zb [m] body; zf [m] foot; vb [m/s]; vf [m/s]"),
        inputs=signals("u [N] force of the leg"),
        contacts=signals("foot [N s] normal impulse"),
        h=h,
        mass=ca.diag(ca.vertcat(mb, mf)),
        impulse=lambda q, v, u: h * ca.vertcat(u - mb * p["g"], -u - mf * p["g"]),
        distance=lambda q: q[1],
        limits=lambda q: ca.vertcat(q[0] - q[1] - p["leg_min"], p["leg_max"] - q[0] + q[1]),
        limit_names=("leg short", "leg long"),
        parameters=p,
    )
    x = system.x
    share = ca.horzcat(mb, mf) / (mb + mf)
    return pose_problem(
        params,
        system,
        stage_cost=ca.SX(0),
        terminal_cost=share @ (ca.vertcat(p["leg0"], 0) - x[:2]) + p["w_v"] * (share @ x[2:]) ** 2,
        x0=ca.vertcat(p["leg0"], 0, 0, 0),
        guess=_standing,
        scaling=Scaling(impulse=1.0, gap=0.01, x=0.5, u=50.0),
    )


def _standing(problem: Problem, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a guess at rest, in which the force of the leg equals the weight of the body."""
    values = problem.parameters.unpack(p)
    states = np.tile([values["leg0"], 0, 0, 0], (problem.N + 1, 1))
    return states, np.full((problem.N, 1), values["mb"] * values["g"])


def draw(params: Params, state: np.ndarray) -> list[Shape]:
    """Draw ground, body, leg and foot; body and foot have sizes only in the picture."""
    body, foot = float(state[0]), float(state[1])
    radius = 0.04
    return [
        Wall(0, 0, 0, 1),
        Segment(0, foot + radius, 0, body + radius, "actuator"),
        Rectangle(0, body + 2 * radius, 0.2, 0.12),
        Circle(0, foot + radius, radius),
    ]


def frames(params: Params, state: np.ndarray) -> list[ContactFrame]:
    """Return the contact frames of the ground on the foot, and of the leg's two stops on the body."""
    body, foot = float(state[0]), float(state[1])
    return [ContactFrame(0, foot, 0, 1), ContactFrame(0, body, 0, 1), ContactFrame(0, body, 0, -1)]
