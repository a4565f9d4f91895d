"""A pendulum on a fixed joint that recovers from a push by pressing its sliding arm against a wall."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np

from dynamics.systems import Signal, signals, time_stepping
from ocp.problem.problem import Problem, Scaling
from problems.drawing import Mark, Segment, Shape, Wall
from problems.machines.tracking import with_nominal
from problems.parameters import Parameters, pose_problem, quantity, structure, table
from problems.spec import Citation

name = "push-recovery"
title = "Push recovery of a pendulum with a sliding arm (ContactImplicitMPC.jl)"
citation = Citation("lecleach2024fast", "ContactImplicitMPC.jl, examples/pushbot: one plan of push_recovery")
axes = ("x [m]", "z [m]")
equations = r"""
M(q) (v^+ - v) = h (B u - b(q, v) - f_j v^+) + J_n^top gamma + J_t^top (beta^+ - beta^-), quad q^+ = q + h v^+
p_b = l (-sin theta, cos theta), quad p_a = p_b + d (cos theta, sin theta), quad M = m_b J_b^top J_b + m_a J_a^top J_a
B = mat(l, 1; 1, 1 / l), quad b = sum_(i in (a, b)) m_i J_i^top (dot(J)_i v + g e_z)
0 <= gamma perp w minus.plus p_(a, x)^+ >= 0, quad 0 <= beta^plus.minus perp psi plus.minus h J_t v^+ >= 0, quad
  0 <= psi perp mu gamma - beta^+ - beta^- >= 0
min sum_(k=0)^(N-1) w_q (k / N)^2 norm(q_k)^2 + v_k^top V v_k + u_k^top R u_k + w_"end" norm(q_N)^2, quad
  V = diag(w_1, w_2), quad R = diag(r_1, r_2)
"""


class Params(Parameters):
    """Parameters of ``push-recovery``; upright is theta = 0, with the middle of the arm at d = 0."""

    m_b: float = quantity(1.0, "kg", "mass of the bob", above=0)
    m_a: float = quantity(0.01, "kg", "mass of the arm's end", above=0)
    l: float = quantity(1.0, "m", "length of the pendulum", above=0)  # noqa: E741
    wall: float = quantity(0.5, "m", "distance of either wall from the middle", above=0)
    friction: float = quantity(0.5, "1", "Coulomb's coefficient with the walls", above=0)
    joint: float = quantity(10.0, "SI", "viscous friction of both joints [N m s/rad, N s/m]", least=0)
    g: float = quantity(9.81, "m/s^2", "gravity", above=0)
    h: float = quantity(0.04, "s", "step size", above=0)
    N: int = structure(40, "number of steps", least=1)
    push: float = quantity(-5.5, "N m s", "impulse on theta before the start")
    w_q: float = quantity(12.0, "1", "weight of the distance to upright at the end of the horizon", least=0)
    w_1: float = quantity(1.0, "s^2/rad^2", "weight of theta's rate", least=0)
    w_2: float = quantity(0.01, "s^2/m^2", "weight of the arm's velocity", least=0)
    r_1: float = quantity(100.0, "1/(N^2 m^2)", "weight of the first input", least=0)
    r_2: float = quantity(1.0, "1/N^2", "weight of the second input", least=0)


def build(params: Params) -> Problem:
    """Return the problem of one plan of the source's controller, with steps (push-recovery.1) and its cost.

    The source runs the controller for 20 s with five such pushes, and weighs the rates of positions between nodes.
    """
    p = table(params)
    h, length, system_time = p["h"], p["l"], Signal("t", "s", "time")
    joint_friction = p["joint"] * ca.SX.eye(2)
    masses, gravity = (p["m_b"], p["m_a"]), ca.vertcat(0, p["g"])

    def jacobians(q: ca.SX) -> tuple[ca.SX, ca.SX]:
        angle = ca.SX.sym("q", 2)
        bob = length * ca.vertcat(-ca.sin(angle[0]), ca.cos(angle[0]))
        arm = bob + angle[1] * ca.vertcat(ca.cos(angle[0]), ca.sin(angle[0]))
        first, second = (ca.substitute(ca.jacobian(point, angle), angle, q) for point in (bob, arm))
        return first, second

    def mass(q: ca.SX) -> ca.SX:
        terms = (m * (J.T @ J) for m, J in zip(masses, jacobians(q), strict=True))
        return sum(terms, ca.SX(2, 2))

    def impulse(q: ca.SX, v: ca.SX, u: ca.SX) -> ca.SX:
        bias = ca.SX(2, 1)
        for m, J in zip(masses, jacobians(q), strict=True):
            bias += m * (J.T @ (ca.jtimes(J @ v, q, v) + gravity))
        actuation = ca.blockcat([[length, 1], [1, 1 / length]]) @ u
        return h * (actuation - bias)

    def reach(q: ca.SX) -> ca.SX:
        return -length * ca.sin(q[0]) + q[1] * ca.cos(q[0])

    system = time_stepping(
        name,
        states=signals("theta [rad] pendulum, anticlockwise; d [m] arm; dtheta [rad/s]; dd [m/s]"),
        inputs=signals("u1 [N m] first input; u2 [N] second input"),
        contacts=signals("right [N s] impulse of the right wall; left [N s] impulse of the left wall"),
        h=h,
        mass=mass,
        impulse=impulse,
        distance=lambda q: ca.vertcat(p["wall"] - reach(q), p["wall"] + reach(q)),
        sliding=lambda q: ca.repmat(jacobians(q)[1][1, :], 2, 1),
        friction=p["friction"],
        damping=joint_friction,
        parameters=p,
    )
    timed = with_nominal(system, ca.SX(1.0), system_time)
    q, v, time = timed.x[:2], timed.x[2:4], timed.x[4]
    rate_cost = p["w_1"] * v[0] ** 2 + p["w_2"] * v[1] ** 2
    input_cost = p["r_1"] * timed.u[0] ** 2 + p["r_2"] * timed.u[1] ** 2
    start_rate = ca.solve(mass(ca.SX.zeros(2)), ca.vertcat(p["push"], 0))
    return pose_problem(
        params,
        timed,
        stage_cost=p["w_q"] * (time / (h * params.N)) ** 2 * ca.sumsqr(q) + rate_cost + input_cost,
        terminal_cost=p["w_q"] * ca.sumsqr(q),
        x0=ca.vertcat(0, 0, start_rate, 0),
        scaling=Scaling(impulse=0.5, gap=0.2, x=0.5, u=5.0),
    )


def draw(params: Params, state: np.ndarray) -> list[Shape]:
    """Draw walls, pendulum, arm and the goal of the bob."""
    sin, cos, d = math.sin(float(state[0])), math.cos(float(state[0])), float(state[1])
    bob = -params.l * sin, params.l * cos
    end = bob[0] + d * cos, bob[1] + d * sin
    walls: list[Shape] = [Wall(params.wall, 0, -1, 0), Wall(-params.wall, 0, 1, 0), Mark(0, params.l, "goal")]
    return [*walls, Segment(0, 0, *bob), Segment(*bob, *end, "actuator"), Mark(*end)]
