"""A drone that lifts a load from the ground by a slack tether, and sets it down elsewhere."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np

from dynamics.systems import Signal, signals, time_stepping
from ocp.problem.problem import Problem, Scaling
from problems.drawing import Mark, Rectangle, Segment, Shape, Wall
from problems.machines.tracking import with_nominal
from problems.parameters import Parameters, pose_problem, quantity, structure, table
from problems.spec import Citation

name = "drone-tether"
title = "Drone with a slack tether and a load on the ground (nosnoc)"
citation = Citation("nurkanovic2022nosnoc", "nosnoc's code, examples, mpc_drone_load_2d")
axes = ("x [m]", "z [m]")
equations = r"""
m_d (v_d^+ - v_d) = h ((u_1 + u_2) (-sin phi, cos phi) - m_d g e_z - c_d v_d) - n lambda_1, quad
  n = (p_d - p_l) / norm(p_d - p_l)
m_l (v_l^+ - v_l) = -h (m_l g e_z + c_l v_l) + n lambda_1 + e_z lambda_2
I (omega^+ - omega) = h (a (u_2 - u_1) - c_phi omega), quad q^+ = q + h v^+
0 <= lambda_1 perp L - norm(p_d^+ - p_l^+) >= 0, quad 0 <= lambda_2 perp z_l^+ - 0.1 >= 0
min h sum_(k=0)^(N-1) e_k^top Q e_k + v_k^top V v_k + w_u norm(u_k - u_"hover")^2 + e_N^top Q_N e_N + v_N^top V_N v_N
e = q - q_"ref"(t), quad q_"ref" "linear between" t = 0, T / 4, 3 T / 4, T
"""
HALF_HEIGHT = 0.1
"""Half the height of the load [m]."""
STAGE_WEIGHTS = (20.0, 20.0, 2.0, 35.0, 40.0), (0.5, 0.5, 0.1, 0.5, 0.5)
"""Weights of positions and of velocities over time, in the order of the states."""
END_WEIGHTS = (80.0, 80.0, 10.0, 150.0, 200.0), (1.0, 1.0, 0.2, 1.0, 1.0)
"""Weights of positions and of velocities at the end, in the order of the states."""


class Params(Parameters):
    """Parameters of ``drone-tether``, with the source's values."""

    m_d: float = quantity(1.0, "kg", "mass of the drone", above=0)
    I: float = quantity(0.05, "kg m^2", "inertia of the drone", above=0)  # noqa: E741
    m_l: float = quantity(0.35, "kg", "mass of the load", above=0)
    L: float = quantity(0.95, "m", "length of the tether", above=0)
    arm: float = quantity(0.22, "m", "distance of a rotor from the drone's centre", above=0)
    c_d: float = quantity(0.1, "N s/m", "drag of the drone", least=0)
    c_phi: float = quantity(0.05, "N m s/rad", "drag of the drone's rotation", least=0)
    c_l: float = quantity(0.05, "N s/m", "drag of the load", least=0)
    g: float = quantity(9.81, "m/s^2", "gravity", above=0)
    h: float = quantity(0.05, "s", "step size", above=0)
    N: int = structure(100, "number of steps", least=1)
    w_u: float = quantity(5e-3, "1/(N^2 s)", "weight of the thrusts", least=0)
    u_max: float = quantity(10.0, "N", "largest thrust of a rotor", above=0)


def build(params: Params) -> Problem:
    """Return the problem with steps (drone-tether.1-3), contacts (drone-tether.4) and cost (drone-tether.5).

    The tether is a contact whose gap is its slack. Hovering thrusts are (m_d + m_l) g / 4 each, as in the source.
    """
    p = table(params)
    h, m_d, m_l, g = p["h"], p["m_d"], p["m_l"], p["g"]
    damping = ca.vertcat(p["c_d"], p["c_d"], p["c_phi"], p["c_l"], p["c_l"])

    def impulse(q: ca.SX, v: ca.SX, u: ca.SX) -> ca.SX:
        thrust = u[0] + u[1]
        lift = ca.vertcat(-thrust * ca.sin(q[2]), thrust * ca.cos(q[2]) - m_d * g, p["arm"] * (u[1] - u[0]))
        return h * (ca.vertcat(lift, 0, -m_l * g) - damping * v)

    system = time_stepping(
        name,
        states=signals(
            "xd [m] drone; zd [m] drone; phi [rad] drone, anticlockwise; xl [m] load; zl [m] load;"
            " vxd [m/s]; vzd [m/s]; omega [rad/s]; vxl [m/s]; vzl [m/s]"
        ),
        inputs=signals("u1 [N] thrust; u2 [N] thrust"),
        contacts=signals("tether [N s] impulse of the tether; ground [N s] impulse of the ground"),
        h=h,
        mass=ca.diag(ca.vertcat(m_d, m_d, p["I"], m_l, m_l)),
        impulse=impulse,
        distance=lambda q: ca.vertcat(p["L"] - ca.norm_2(q[:2] - q[3:]), q[4] - HALF_HEIGHT),
        parameters=p,
    )
    timed = with_nominal(system, ca.SX(1.0), Signal("t", "s", "time"))
    q, v, time = timed.x[:5], timed.x[5:10], timed.x[10]
    error, hover = q - reference(time, h * params.N), (m_d + m_l) * g / 4

    def distance(weights: tuple[tuple[float, ...], tuple[float, ...]]) -> ca.SX:
        return ca.dot(ca.DM(weights[0]), error**2) + ca.dot(ca.DM(weights[1]), v**2)

    return pose_problem(
        params,
        timed,
        stage_cost=h * (distance(STAGE_WEIGHTS) + p["w_u"] * ca.sumsqr(timed.u - hover)),
        terminal_cost=distance(END_WEIGHTS),
        x0=ca.vertcat(0, 1.05, 0, 0, HALF_HEIGHT, ca.SX.zeros(6)),
        scaling=Scaling(impulse=0.3, gap=0.2, x=1.0, u=5.0),
    )


def reference(time: ca.SX, duration: ca.SX) -> ca.SX:
    """Return the reference pose (5, 1) at a time [s]: up within T/4, across within T/2, down within T/4."""

    def risen(start: float, end: float) -> ca.SX:
        return ca.fmin(ca.fmax((time / duration - start) / (end - start), 0), 1)

    up, sideways, down = risen(0, 0.25), risen(0.25, 0.75), risen(0.75, 1)
    return ca.vertcat(4 * sideways, 1.05 + 1.5 * up - 2.1 * down, 0, 4 * sideways, HALF_HEIGHT + 1.5 * (up - down))


def draw(params: Params, state: np.ndarray) -> list[Shape]:
    """Draw ground, drone, load, tether and the load's goal."""
    xd, zd, phi, xl, zl = (float(value) for value in state[:5])
    ends = params.arm * math.cos(phi), params.arm * math.sin(phi)
    return [
        Wall(0, 0, 0, 1),
        Mark(4, HALF_HEIGHT, "goal"),
        Segment(xd, zd, xl, zl),
        Segment(xd - ends[0], zd - ends[1], xd + ends[0], zd + ends[1], "actuator"),
        Rectangle(xl, zl, 0.2, 2 * HALF_HEIGHT),
    ]
