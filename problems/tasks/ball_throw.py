"""The ball throw as a task: the first action sets angle and speed, and the final state gives the reward."""

from __future__ import annotations

import casadi as ca
import numpy as np

from dynamics.systems import ParameterTable
from ocp.problem.task import Task
from problems.library import ball_throw as problem
from problems.parameters import quantity, structure, table
from problems.spec import Citation

name = "ball-throw"
title = "Ball throw: arrive at a goal by way of the floor"
citation = Citation("zhang2023adaptive", "Adaptive barrier smoothing, fig. 7a; numbers are ours")
axes, draw, frames = problem.axes, problem.draw, problem.frames
decisions = 1
observation_bounds = {"hand": (0.0, 1.0)}
training = {"all": {"hidden": None, "unroll": 1000, "rate": 0.05}, "ars": {"rate": 0.1}}
equations = r"""
max -norm(q_N - q_"goal")^2 - w_v norm(v_N - v_"goal")^2, quad "dynamics as the problem ball-throw"
"over angle" theta "and speed" s "of the first input; later ones move nothing"
theta "in" [-1.5, 1.5] "rad," quad s "in" [0, s_"max"], "or a fixed speed"
"""
STEEPEST_THROW = 1.5
"""Largest angle of the throw, up or down [rad]."""


class Params(problem.ThrowParameters):
    """Parameters of ``ball-throw``."""

    horizon: int = structure(50, "steps of the flight", least=2)
    speed_max: float = structure(10.0, "largest speed of the throw", unit="m/s", above=0)
    fixed_speed: int = structure(0, "1 to choose only the angle, as in the paper; 0 to choose the speed too", most=1)
    speed: float = quantity(3.0, "m/s", "speed of the throw where it is fixed", least=0)


def build(params: Params) -> Task:
    """Build the task, whose only reward is at the end; the state is (x, z, vx, vz, hand, fall)."""
    p = table(params)
    if not params.fixed_speed:
        p = ParameterTable(parameter for parameter in p if parameter.name != "speed")
    system = problem.thrown_ball(p, p["speed"] if params.fixed_speed else None)
    x = system.x
    error = x[:4] - ca.vertcat(*(p[f"goal_{key}"] for key in ("x", "z", "vx", "vz")))
    return Task(
        name=name,
        system=system,
        parameters=p,
        horizon=params.horizon,
        start=ca.vertcat(p["x0"], p["z0"], 0, 0, 1, 2 * p["g"] * p["z0"]),
        chance=ca.SX(0, 1),
        reward=ca.SX(0),
        final=-ca.sumsqr(error[:2]) - p["w_v"] * ca.sumsqr(error[2:]),
        observation=x[:5],
        observations=system.states[:5],
        lower=np.array([-STEEPEST_THROW, 0.0][: system.nu]),
        upper=np.array([STEEPEST_THROW, params.speed_max][: system.nu]),
    )
