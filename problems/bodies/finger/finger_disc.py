"""A finger that turns a disc to an angle, starting in contact with it."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np
from pydantic import model_validator

from dynamics.systems import ParameterTable
from ocp.problem.problem import Problem, Scaling
from problems.bodies.finger.machine import STEPS, FingerParams, finger_frames, finger_shapes, finger_system
from problems.drawing import Shape
from problems.parameters import pose_problem, quantity, structure, table
from problems.spec import Citation, Golden

name = "finger-disc"
title = "A finger that turns a disc to an angle"
citation = Citation("nurkanovic2022nosnoc", "nosnoc's finger and disc; its code, examples/mpc/mpc_finger_ball")
axes = ("x [m]", "z [m]")
equations = (
    STEPS
    + r"""q_0: quad p(q_0) = c - (R + r, 0), quad q_2 > 0: "the elbow is above the line to the tip"
e^2 = w_a ((q_1 - q_(1,0))^2 + (q_2 - q_(2,0))^2) + w_d (q_3 - theta)^2
min sum_(k=0)^(N-1) h (e_k^2 + w_v (v_1^2 + v_2^2) + w_omega v_3^2 + w_u norm(u_k)^2)
  + w_"end" e_N^2 + w_"rest" norm(v_N)^2, quad abs(u) <= u_"max"
"""
)
golden = {"exact": Golden(1.6414158127, tried=24)}


class Params(FingerParams):
    """Parameters of ``finger-disc``; the default weights are near those of the source."""

    m: float = quantity(0.5, "kg", "mass of either link, centred in its middle", above=0)
    damping: float = quantity(0.0, "N m s/rad", "damping of either joint", least=0)
    r: float = quantity(0.0, "m", "radius of the fingertip, a point by default", least=0)
    R: float = quantity(0.3, "m", "radius of the disc", above=0)
    disc_inertia: float = quantity(0.0225, "kg m^2", "inertia of the disc, of 0.5 kg", above=0)
    friction: float = quantity(0.8, "1", "Coulomb's coefficient of tip and disc", least=0)
    N: int = structure(15, "number of steps", least=1)
    goal: float = quantity(math.pi / 4, "rad", "goal angle theta of the disc, clockwise")
    u_max: float = quantity(10.0, "N m", "largest torque", above=0)
    w_a: float = quantity(0.1, "1/s", "weight of the joints' distance to their start", least=0)
    w_d: float = quantity(20.0, "1/s", "weight of the disc's distance to its goal", least=0)
    w_v: float = quantity(1.0, "s", "weight of the joints' velocities", least=0)
    w_omega: float = quantity(1e-3, "s", "weight of the disc's velocity", least=0)
    w_u: float = quantity(0.01, "1/(N^2 m^2 s)", "weight of the torques", least=0)
    w_end: float = quantity(0.5, "s", "terminal weight, relative to the stage weights per second", least=0)
    w_rest: float = quantity(0.1, "s^2", "terminal weight of the velocities", least=0)

    @model_validator(mode="after")
    def _start_is_in_reach(self) -> Params:
        away = math.hypot(self.x - self.R - self.r, self.z)
        if not self.r < away < 2 * self.length - self.r:
            raise ValueError(
                f"the finger starts at the disc's left side, {away:.6g} m away, and reaches up to"
                f" {2 * self.length - self.r:g} m; bring x, z nearer or make length greater"
            )
        return self


def _start(p: ParameterTable) -> ca.SX:
    """Return the angles (2, 1) [rad] of shoulder and elbow at which the tip touches the disc from the left."""
    x, z, a, b = p["x"] - p["R"] - p["r"], p["z"], p["length"], p["length"] - p["r"]
    elbow = ca.acos((x**2 + z**2 - a**2 - b**2) / (2 * a * b))
    return ca.vertcat(ca.atan2(x, z) - ca.atan2(b * ca.sin(elbow), a + b * ca.cos(elbow)), elbow)


def build(params: Params) -> Problem:
    """Return the problem with steps (finger-disc.1), contact (finger-disc.2) and cost (finger-disc.5).

    The start is (finger-disc.3), the tracking error is (finger-disc.4), the state is (q, v); lam are impulses [N s].
    Impacts are plastic. In the source the tip starts away from the disc, a penalty keeps it left of 1.4 m, and
    torques are at most 15 N m. The source's weights on the errors of the joints are 0.5 and 0.1; its terminal weights
    on these errors and on the disc's velocity are 1.
    """
    p = table(params)
    system = finger_system(name, p)
    p = system.parameters
    q, v, posture = system.x[:3], system.x[3:], _start(p)
    squared_error = p["w_a"] * ca.sumsqr(q[:2] - posture) + p["w_d"] * (q[2] - p["goal"]) ** 2
    moving = p["w_v"] * ca.sumsqr(v[:2]) + p["w_omega"] * v[2] ** 2
    return pose_problem(
        params,
        system,
        stage_cost=p["h"] * (squared_error + moving + p["w_u"] * ca.sumsqr(system.u)),
        terminal_cost=p["w_end"] * squared_error + p["w_rest"] * ca.sumsqr(v),
        x0=ca.vertcat(posture, ca.SX.zeros(4)),
        scaling=Scaling(impulse=0.5, gap=0.1, x=0.5, u=5.0),
    )


def draw(params: Params, state: np.ndarray) -> list[Shape]:
    """Draw finger and disc, and the disc's goal."""
    return finger_shapes(params, state, params.goal)


frames = finger_frames
