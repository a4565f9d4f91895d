"""A ball thrown so that it reaches a goal, with a given velocity, after one bounce."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from dynamics.systems import ContactSystem, ParameterTable, RefereeModel, signals
from ocp.problem.problem import Problem, Scaling
from problems.drawing import Circle, ContactFrame, Mark, Shape, Wall
from problems.parameters import Parameters, pose_problem, quantity, structure, table
from problems.spec import Citation, Golden

name = "ball-throw"
title = "A ball thrown to a goal by way of the floor"
citation = Citation("zhang2023adaptive", "Adaptive barrier smoothing, fig. 7a; numbers are ours")
axes = ("x [m]", "z [m]")
equations = r"""
w = v + "hand" (s cos theta, s sin theta + g h \/ 2), quad "hand" = 1 "at first, then" 0
m (v^+ - w) = h (0, -m g) + (0, lambda), quad q^+ = q + h v^+, quad v "the mean velocity of a step"
0 <= lambda perp z^+ + R(z - h w_z) >= 0, quad R(d) = e d + (1 + e) g d^2 \/ (2 V^2), quad
  e "the restitution"
V^2 = (w_z - g h \/ 2)^2 + 2 g z "one step before: the square of the speed at the floor"
min w_"speed" s^2 + w_"end" norm(q_N - q_"goal")^2 + w_v norm(v_N - v_"goal")^2
"over angle" theta "and speed" s "of the throw; later inputs move nothing and are put to zero"
"""
golden = {
    "exact": Golden(
        0.00898210373,
        settings={"tol": 1e-10},
        tried=33,
        independent="Nelder-Mead over angle and speed of a simulation in closed form",
        # The N - 1 speeds after the throw, as shares u of the largest, cost u² each and have the
        # bound u >= 0. An interior-point method ends where 2 u² = mu <= tol, which costs
        # (N - 1) tol / 2 in all: 2.7e-7 of the optimum at tol = 1e-10, 2.7e-5 at 1e-8.
        tolerance=1e-6,
    )
}


class ThrowParameters(Parameters):
    """Parameters of a throw; the default goal is the end point of a throw at theta = 0.6 rad and 3 m/s."""

    m: float = quantity(1.0, "kg", "mass", above=0)
    g: float = quantity(9.81, "m/s^2", "gravity", above=0)
    restitution: float = quantity(0.7, "1", "velocity after a bounce over that before", least=0, most=1)
    h: float = quantity(0.02, "s", "step size", above=0)
    x0: float = quantity(0.0, "m", "start in the hand, x")
    z0: float = quantity(1.0, "m", "start in the hand, height above the floor", least=0)
    goal_x: float = quantity(2.476, "m", "goal, x")
    goal_z: float = quantity(0.5547, "m", "goal, height", least=0)
    goal_vx: float = quantity(2.476, "m/s", "velocity at the goal, x")
    goal_vz: float = quantity(0.4327, "m/s", "velocity at the goal, upwards")
    w_v: float = quantity(0.1, "s^2/m^2", "weight of the velocity's error", least=0)


class Params(ThrowParameters):
    """Parameters of ``ball-throw``."""

    N: int = structure(50, "number of steps", least=2)
    w_speed: float = quantity(1e-3, "s^2/m^2", "weight of the throw", least=0)
    w_end: float = quantity(1.0, "1/m^2", "terminal weight of the distance to the goal", least=0)
    theta_start: float = structure(-0.3, "angle of the guess", least=-1.5, most=1.5, unit="rad")
    speed_start: float = structure(3.0, "speed of the guess", unit="m/s")
    speed_max: float = quantity(10.0, "m/s", "largest speed of the throw", above=0)


def build(params: Params) -> Problem:
    """Return the problem with time steps (ball-throw.2) and restitution (ball-throw.3); lam is an impulse [N s].

    In free flight the nodes are on a parabola, since the velocity of a step is the velocity at its
    middle. The contact keeps the next node above ``-R(s)``, where s is the height at the node before the
    current node: two steps in contact, with heights a > c at these earlier nodes, end at ``-R(a)`` and
    ``-R(c)``. ``R(s) = e s`` is the published scheme, in which the velocity after a bounce is e times
    the velocity before it, wherever the impact is between two nodes. Since gravity also acts in between,
    the velocity is a sawtooth function of the position of the impact: its slope has the wrong sign for every
    h, and each tooth is a local minimum. The quadratic term of R reflects the parabola instead of
    its tangent, and leaves a delay of two steps. The node in between is at most e h V below the floor.

    Source: Paoli and Schatzman, SIAM J. Numer. Anal. 40(2), 702-733, 2002 (paoli2002numerical).
    """
    p = table(params)
    system = thrown_ball(p)
    theta, speed = ca.vertsplit(system.u)
    hand = system.x[4]
    goal = ca.vertcat(*(p[f"goal_{key}"] for key in ("x", "z", "vx", "vz")))
    error = system.x[:4] - goal
    thrown = p["w_speed"] * speed**2
    # Inputs after the throw have no effect; a cost with ten times the weight makes them unique.
    idle = 10 * p["w_speed"] * (speed**2 + (p["speed_max"] * theta) ** 2)
    return pose_problem(
        params,
        system,
        stage_cost=hand * thrown + (1 - hand) * idle,
        terminal_cost=p["w_end"] * ca.sumsqr(error[:2]) + p["w_v"] * ca.sumsqr(error[2:]),
        x0=ca.vertcat(p["x0"], p["z0"], 0, 0, 1, 2 * p["g"] * p["z0"]),
        u_lower=ca.SX([-1.5, 0]),
        u_upper=ca.vertcat(1.5, p["speed_max"]),
        guess=_guess(params),
        scaling=Scaling(impulse=1.0, gap=0.1, x=0.5, u=1.0),
    )


def thrown_ball(p: ParameterTable, fixed_speed: ca.SX | None = None) -> ContactSystem:
    """Return the contact system of :func:`build`; with ``fixed_speed`` [m/s] the angle is the only input."""
    x, x_next = ca.SX.sym("x", 6), ca.SX.sym("x_next", 6)
    theta, lam = ca.SX.sym("theta"), ca.SX.sym("lam")
    speed = ca.SX.sym("speed") if fixed_speed is None else fixed_speed
    inputs = signals("theta [rad] angle of the throw; speed [m/s] of the throw")
    q, v, hand, fall = x[:2], x[2:4], x[4], x[5]
    q_next, v_next = x_next[:2], x_next[2:4]
    m, g, h, e = p["m"], p["g"], p["h"], p["restitution"]
    lift = ca.vertcat(0, g * h / 2)
    thrown = v + hand * (speed * ca.vertcat(ca.cos(theta), ca.sin(theta)) + lift)
    push = ca.vertcat(0, lam - h * m * g)
    last = q[1] - h * thrown[1]
    return ContactSystem(
        name=name,
        x=x,
        u=ca.vertcat(theta, speed) if fixed_speed is None else theta,
        x_next=x_next,
        lam=lam,
        residual=ca.vertcat(
            q_next - q - h * v_next,
            m * (v_next - thrown) - push,
            x_next[4],
            x_next[5] - (thrown[1] - g * h / 2) ** 2 - 2 * g * q[1],
        ),
        gap=q_next[1] + _reflected_height(last, fall, e, g, h),
        states=signals(
            "x [m]; z [m] height; vx [m/s]; vz [m/s]; hand [1] 1 before the throw;"
            " fall [m^2/s^2] speed at the floor, squared"
        ),
        inputs=inputs if fixed_speed is None else inputs[:1],
        contacts=signals("floor [N s] impulse of the floor"),
        h=h,
        parameters=p,
        phi=q[1],
        mu_per_kappa=h,
        # The gap contains the law of the bounce, so it is not an expansion of the distance.
        referee_model=RefereeModel(),
        refinable=True,
    )


def _reflected_height(last: Any, fall: Any, e: Any, g: Any, h: Any) -> Any:
    """Return the height R(s) [m] of a bounce, see (ball-throw.3), for the height s = ``last`` two nodes before."""
    # Just after a bounce the state `fall` is small, and can even be negative.
    return e * last + (1 + e) * g * last**2 / (2 * ca.fmax(fall, (g * h) ** 2))


def roll(params: Params, theta: float, speed: float) -> np.ndarray:
    """Return the states (N+1, 6) of one throw under the exact law, step by step in closed form."""
    h, e, g = params.h, params.restitution, params.g
    states = np.zeros((params.N + 1, 6))
    fall = 2 * g * params.z0
    states[0] = params.x0, params.z0, 0, 0, 1, fall
    x, z = params.x0, params.z0
    vx, vz = speed * np.cos(theta), speed * np.sin(theta) + g * h / 2
    for k in range(params.N):
        reflected = _reflected_height(z - h * vz, fall, e, g, h)
        fall = (vz - g * h / 2) ** 2 + 2 * g * z
        vz = max(vz - h * g, -(reflected + z) / h)
        x, z = x + h * vx, z + h * vz
        states[k + 1] = x, z, vx, vz, 0, fall
    return states


def _guess(params: Params):
    def guess(problem: Problem, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        inputs = np.zeros((params.N, 2))
        inputs[0] = params.theta_start, params.speed_start
        values = problem.parameters.unpack(p)
        updated = params.model_copy(update=values)
        return roll(updated, params.theta_start, params.speed_start), inputs

    return guess


def draw(params: Any, state: np.ndarray) -> list[Shape]:
    """Draw floor, hand, goal and ball; the ball is a point in the model and has a radius only in the picture."""
    radius = 0.05
    return [
        Wall(0, 0, 0, 1),
        Mark(params.x0, params.z0 + radius, "environment"),
        Mark(params.goal_x, params.goal_z + radius, "goal"),
        Circle(float(state[0]), float(state[1]) + radius, radius),
    ]


def frames(params: Any, state: np.ndarray) -> list[ContactFrame]:
    """Return the contact frame of the floor, whose normal points upwards."""
    return [ContactFrame(float(state[0]), float(state[1]), 0, 1)]
