"""Problems written as a user would write them, whose plans exploit weaknesses of their contact model."""

from __future__ import annotations

import casadi as ca
import numpy as np

from dynamics.systems import (
    Parameter,
    ParameterTable,
    quasi_dynamic,
    signals,
    time_stepping,
)
from ocp.problem.evaluation import Evaluation
from ocp.problem.problem import Problem, Scaling
from ocp.problem.rollout import Rollout


def defaults(problem: Problem) -> dict[str, float]:
    """Return a mapping from parameter of a problem to its value."""
    return {parameter.name: parameter.value for parameter in problem.parameters}


def physical(problem: Problem) -> np.ndarray:
    """Return the values (n,) of a problem's parameters, in their order."""
    return problem.parameters.values


def at_defaults(problem: Problem) -> Evaluation:
    """Return an evaluation of the problem at its parameters' defaults."""
    return Evaluation(problem, defaults(problem))


def trajectories(x: np.ndarray, u: np.ndarray, lam: np.ndarray) -> Rollout:
    """Return trajectories as a rollout whose multipliers are the problem's impulses."""
    return Rollout(x, u, lam, 0 * lam, lam, np.zeros(len(x)))


def round_a_post(N: int = 10, linearised: bool = True) -> Problem:
    """Return a problem of a disc that a smaller one pushes past a fixed post.

    It is quasi-dynamic and frictionless; the contacts are pusher-disc, disc-post and pusher-post.
    """
    p = ParameterTable([Parameter("h", 0.1, "s"), Parameter("post", 0.3, "m")])

    def distance(q: ca.SX) -> ca.SX:
        disc, pusher = q[:2], q[2:]
        return ca.vertcat(
            ca.norm_2(disc - pusher) - 0.3,
            ca.norm_2(disc) - 0.2 - p["post"],
            ca.norm_2(pusher) - 0.1 - p["post"],
        )

    system = quasi_dynamic(
        "round a post",
        states=signals("x [m] disc; y [m] disc; ax [m] pusher; ay [m] pusher"),
        inputs=signals("ux [m] commanded pusher; uy [m] commanded pusher"),
        contacts=signals("push [N s]; post [N s]; pusher at post [N s]"),
        h=p["h"],
        mass=ca.SX.eye(2),
        stiffness=50.0 * ca.SX.eye(2),
        distance=distance,
        parameters=p,
        linearised=linearised,
    )
    x, du = system.x, ca.SX.sym("du", 2)
    off = ca.sumsqr(x[:2] - ca.SX([-0.7, 0.0]))
    return Problem(
        name="round a post",
        system=system,
        N=N,
        stage_cost=0.1 * ca.sumsqr(du),
        terminal_cost=10 * off,
        x0=ca.SX([0.7, 0.1, 0.3, 0.6]),
        parameters=p,
        du=du,
        u_before=ca.SX([0.3, 0.6]),
        scaling=Scaling(impulse=0.5, gap=0.1, x=0.5, u=0.5),
    )


def rough_slope(N: int = 10) -> Problem:
    """Return a problem of a cart that pushes a block up a rough slope, q = (cart, block, height over the slope).

    The cart's face is rough too. If block and cart move together, the face's friction may press the
    block onto the slope or lift it off, so that the motion is not determined.
    """
    p = ParameterTable(
        [
            Parameter("h", 0.05, "s"),
            Parameter("slope", 0.4, "rad"),
            Parameter("goal", 0.6, "m"),
            Parameter("friction", 0.6),
            Parameter("face", 0.6),
        ]
    )
    h, weight = p["h"], 9.81
    along, across = weight * ca.sin(p["slope"]), weight * ca.cos(p["slope"])
    system = time_stepping(
        "rough slope",
        states=signals(
            "cart [m]; block [m] along; height [m] over the slope; v_cart [m/s]; v_block [m/s]; v_height [m/s]"
        ),
        inputs=signals("u [N] force on the cart"),
        contacts=signals("slope [N s]; face [N s]"),
        mass=ca.SX.eye(3),
        impulse=lambda q, v, u: h * ca.vertcat(u - along, -along, -across),
        distance=lambda q: ca.vertcat(q[2], q[1] - q[0]),
        sliding=lambda q: ca.SX([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
        friction=ca.vertcat(p["friction"], p["face"]),
        h=h,
        parameters=p,
    )
    x = system.x
    return Problem(
        name="rough slope",
        system=system,
        N=N,
        stage_cost=1e-4 * system.u**2,
        terminal_cost=100 * (x[1] - p["goal"]) ** 2 + ca.sumsqr(x[3:]),
        x0=ca.SX.zeros(6),
        parameters=p,
        u_lower=0,
        u_upper=60,
        scaling=Scaling(impulse=0.5, gap=0.1, x=0.5, u=10.0),
    )


def two_grippers(friction: float = 0.0, N: int = 8) -> Problem:
    """Return a problem of a disc between two fingers on springs, with friction at the left one only."""
    p = ParameterTable([Parameter("h", 0.1, "s"), Parameter("oiled", friction)])

    def sides(q: ca.SX) -> ca.SX:
        return ca.vertcat(q[0] - q[3] - 0.2, q[4] - q[0] - 0.2)

    system = quasi_dynamic(
        "two grippers",
        states=signals("x [m] disc; y [m] disc; a [rad] disc; left [m]; right [m]; ly [m]; ry [m]"),
        inputs=signals("u_left [m]; u_right [m]; u_ly [m]; u_ry [m]"),
        contacts=signals("left [N s]; right [N s]"),
        h=p["h"],
        mass=ca.diag(ca.SX([1.0, 1.0, 0.02])),
        stiffness=50.0 * ca.SX.eye(4),
        distance=sides,
        parameters=p,
        friction=ca.vertcat(0.5, p["oiled"]),
        sliding=lambda q: ca.SX(
            [
                [0, 1.0, 0.2, 0, 0, -1.0, 0],
                [0, 1.0, -0.2, 0, 0, 0, -1.0],
            ]
        ),
    )
    x, u = system.x, system.u
    return Problem(
        name="two grippers",
        system=system,
        N=N,
        stage_cost=0.01 * ca.sumsqr(u - x[3:]),
        terminal_cost=10 * (x[1] - 0.3) ** 2,
        x0=ca.SX([0, 0, 0, -0.2, 0.2, 0, 0]),
        parameters=p,
        scaling=Scaling(impulse=0.3, gap=0.05, x=0.3, u=0.3),
    )


def ring(h: float, speed: float, N: int = 20) -> Problem:
    """Return a problem of a puck inside a fence of radius 1, thrown at it from (0.9, 0)."""
    p = ParameterTable([Parameter("h", h, "s")])
    system = time_stepping(
        "ring",
        states=signals("x [m]; y [m]; vx [m/s]; vy [m/s]"),
        inputs=signals("fx [N]; fy [N]"),
        contacts=signals("ring [N s]"),
        h=p["h"],
        mass=ca.SX.eye(2),
        impulse=lambda q, v, u: p["h"] * u,
        distance=lambda q: 1.0 - ca.norm_2(q),
        parameters=p,
        linearised=True,
    )
    effort = ca.sumsqr(system.u)
    return Problem("ring", system, N, effort, ca.SX(0), ca.SX([0.9, 0, 0, speed]), p)
