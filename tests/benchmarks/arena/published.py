"""Tasks of InteriorPointDDP.jl in its own variables, with its l1 penalty, as its scripts for IPOPT state them."""

from __future__ import annotations

import math
from collections.abc import Callable

import casadi as ca
import numpy as np

from ocp.problem.problem import Problem
from tests.benchmarks.arena.peers import Answer, Script, penalised

PENALTY = 2.0
"""Weight of the products in all three tasks."""


def _implicit(script: Script, h: float, N: int) -> tuple[ca.MX, ca.MX, Callable[[int], tuple[ca.MX, ...]]]:
    """Add poses (2, N + 2) at rest at zero first, and inputs (N); return them and the midpoints of a step."""
    opti = script.opti
    q, force = opti.variable(2, N + 2), opti.variable(1, N)
    opti.subject_to(q[:, 0] == 0)
    opti.subject_to(q[:, 1] == 0)

    def midpoints(k: int) -> tuple[ca.MX, ...]:
        before, now, after = (q[:, k + i] for i in range(3))
        return (before + now) / 2, (now - before) / h, (now + after) / 2, (after - now) / h

    return q, force, midpoints


def _balance(mass: Callable, bias: Callable, h: float, points: tuple[ca.MX, ...]) -> ca.MX:
    m0, v0, m1, v1 = points
    return mass(m1) @ v1 - mass(m0) @ v0 + h / 2 * (bias(m1, v1) + bias(m0, v0))


def _end_cost(q: ca.MX, goal: list[float], h: float) -> ca.MX:
    return 200 * ca.sumsqr((q[:, -1] - q[:, -2]) / h) + 700 * ca.sumsqr(q[:, -1] - ca.DM(goal))


def acrobot(problem: Problem) -> Answer:
    """Solve acrobot-stops with poses, torques and impulses of the stops."""
    p, N, h = problem.parameters.defaults, problem.N, 0.05
    m1, l1, m2, inertia, lc, g = p["m1"], p["l1"], p["m2"], p["I"], p["lc"], p["g"]
    script = Script(PENALTY)
    q, torque, midpoints = _implicit(script, h, N)

    def mass(pose: ca.MX) -> ca.MX:
        a = m2 * l1 * lc * ca.cos(pose[1])
        return ca.blockcat([[2 * inertia + m2 * l1**2 + 2 * a, inertia + a], [inertia + a, ca.MX(inertia)]])

    def bias(pose: ca.MX, v: ca.MX) -> ca.MX:
        a, low = m2 * l1 * lc * ca.sin(pose[1]), m2 * g * lc * ca.sin(pose[0] + pose[1])
        high = (m1 * lc + m2 * l1) * g * ca.sin(pose[0])
        return ca.vertcat(high + low - a * v[1] * (2 * v[0] + v[1]), low + a * v[0] ** 2)

    stops = []
    for k in range(N):
        points = midpoints(k)
        lam, gap = script.positive(2), script.positive(2)
        push = ca.vertcat(0, h * torque[k] + lam[1] - lam[0])
        script.opti.subject_to(_balance(mass, bias, h, points) + h * p["damping"] * points[3] == push)
        script.opti.subject_to(gap == math.pi / 2 + ca.vertcat(-q[1, k + 2], q[1, k + 2]))
        script.opti.subject_to(script.opti.bounded(-8, torque[k], 8))
        script.product(lam, gap)
        script.cost += 0.01 * h * torque[k] ** 2
        stops.append(lam)
    script.cost += _end_cost(q, [math.pi, 0], h)

    def read(value: Callable) -> tuple[np.ndarray, ...]:
        pose, lam = value(q), value(ca.horzcat(*stops))
        v = np.diff(pose) / h
        command = pose[1, 2:] + lam[0] - lam[1]
        return np.vstack([pose[:, 1:], v]).T, np.vstack([value(torque), v[0, 1:], command]).T, lam.T

    return script.solve(read)


def cartpole(problem: Problem) -> Answer:
    """Solve cartpole-friction with poses, forces and, for each joint, two directions of friction and a slip."""
    p, N, h = problem.parameters.defaults, problem.N, 0.05
    mc, mp, length, g = p["mc"], p["mp"], p["l"], p["g"]
    limit = np.array([p["f1"] * (mc + mp) * g, p["f2"] * mp * g * length])
    script = Script(PENALTY)
    q, force, midpoints = _implicit(script, h, N)

    def mass(pose: ca.MX) -> ca.MX:
        a = mp * length * ca.cos(pose[1])
        return ca.blockcat([[ca.MX(mc + mp), a], [a, ca.MX(mp * length**2)]])

    def bias(pose: ca.MX, v: ca.MX) -> ca.MX:
        return mp * length * ca.sin(pose[1]) * ca.vertcat(-(v[1] ** 2), g)

    frictions = []
    for k in range(N):
        points = midpoints(k)
        up, down, slip = (script.positive(2) for _ in range(3))
        margins = [script.positive(2) for _ in range(3)]
        v, friction = points[3], up - down
        script.opti.subject_to(_balance(mass, bias, h, points) == h * (ca.vertcat(force[k], 0) + friction))
        sides = v + slip, slip - v, ca.DM(limit) - up - down
        for side, margin, partner in zip(sides, margins, (up, down, slip), strict=True):
            script.opti.subject_to(margin == side)
            script.product(partner, margin)
        script.opti.subject_to(script.opti.bounded(-10, force[k], 10))
        script.cost += 0.01 * h * force[k] ** 2
        frictions.append(friction)
    script.cost += _end_cost(q, [0, math.pi], h)

    def read(value: Callable) -> tuple[np.ndarray, ...]:
        pose, friction = value(q), value(ca.horzcat(*frictions))
        v = np.diff(pose) / h
        after = v[:, 1:]
        lam = np.vstack([np.maximum(-after, 0), np.maximum(after, 0)])
        return np.vstack([pose[:, 1:], v]).T, np.vstack([value(force), friction - after]).T, lam.T

    return script.solve(read)


def pushing(problem: Problem) -> Answer:
    """Solve pushing-obstacle with forces, margins of the cone, rates of sliding and slack of the obstacle."""
    p, N, h = problem.parameters.defaults, problem.N, 0.04
    script = Script(PENALTY)
    opti = script.opti
    x, force = opti.variable(4, N + 1), opti.variable(2, N)
    opti.set_initial(force, 0.01)
    opti.subject_to(x[:, 0] == 0)
    reach = p["r"] + max(p["zx"], p["zy"]) + p["margin"]
    rates = []
    slacks = []
    for k in range(N):
        fn, ft, now = force[0, k], force[1, k], x[:, k]
        rate, margin, slack = script.positive(2), script.positive(2), script.positive(1)
        cos, sin = ca.cos(now[2]), ca.sin(now[2])
        turn = p["zx"] / 2 * (ca.tan(now[3]) * fn - ft) / p["c"] ** 2
        move = ca.vertcat(cos * fn - sin * ft, sin * fn + cos * ft, turn, rate[0] - rate[1])
        opti.subject_to(x[:, k + 1] == now + h * move)
        opti.subject_to(margin == p["friction"] * fn + ca.vertcat(-ft, ft))
        opti.subject_to(reach**2 - ca.sumsqr(now[:2] - ca.DM([p["ox"], p["oy"]])) <= slack)
        opti.subject_to(opti.bounded(0, fn, p["f_max"]))
        opti.subject_to(opti.bounded(-p["f_max"], ft, p["f_max"]))
        opti.subject_to(opti.bounded(-0.9, now[3], 0.9))
        opti.subject_to(rate <= 3)
        script.product(rate, margin)
        script.cost += 1e-2 * ca.sumsqr(force[:, k]) + 2 * slack
        rates.append(rate)
        slacks.append(slack)
    script.cost += 20 * ca.sumsqr(x[:, N] - ca.DM([0.3, 0.4, 1.5 * math.pi, 0]))

    def read(value: Callable) -> tuple[np.ndarray, ...]:
        f, lam = value(force), value(ca.horzcat(*rates))
        y = p["friction"] * f[0] + np.vstack([-f[1], f[1]]) - p["damper"] * lam
        return value(x).T, np.vstack([y, value(ca.horzcat(*slacks))]).T, lam.T

    return script.solve(read)


SCRIPTS: dict[str, Callable[[Problem], Answer]] = {
    "acrobot-stops": acrobot,
    "cartpole-friction": cartpole,
    "pushing-obstacle": pushing,
}
"""Mapping from task to its published formulation; other tasks are solved in the workbench's form, by Scholtes."""


def solve_published(name: str, problem: Problem) -> Answer:
    """Return the answer of a task's published formulation."""
    return SCRIPTS.get(name, penalised)(problem)
