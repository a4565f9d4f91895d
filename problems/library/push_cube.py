"""A fingertip that pushes a cube over a table in space, or tips it over an edge."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import cache, partial

import casadi as ca
import numpy as np
from pydantic import model_validator

from dynamics.systems import ParameterTable
from dynamics.systems.space import Body, Box, Plane, SpatialMachine, SpatialPart, Sphere, rotation
from dynamics.systems.space.body import Number
from ocp.problem.problem import Problem, Scaling
from problems.drawing import Circle, ContactFrame, Outline, Shape
from problems.machines.perspective import PinholeCamera
from problems.machines.spatial import AXES, spatial_frames, spatial_shapes
from problems.parameters import Parameters, choice, pose_problem, quantity, structure, table
from problems.spec import Citation, Golden

name = "push-cube"
title = "A fingertip pushes or tips a cube on a table, in space"
citation = Citation("suh2023noising", "Noising data, sec. V, its quasi-dynamic model; task ours")
axes = AXES
equations = r"""
"cube" o "at" p "with the unit quaternion" q "and the velocities" v_o = (dot(p), omega), quad
  "fingertip" t, quad c "commanded"
M v_o^+ = h (0, 0, -m g, 0, 0, 0) + J_(n,o)^top gamma + J_(t,o)^top beta, quad
  M = diag(m, m, m, I, I, I), quad I = m a^2 \/ 6
h K (t^+ - c) = J_(n,t)^top gamma + J_(t,t)^top beta
p^+ = p + h dot(p)^+, quad q^+ = q exp(h omega^+ \/ 2)
0 <= gamma_i perp phi_i (p^+, q^+, t^+) >= 0, quad i "each corner on the table, and the tip"
0 <= beta_(i k) perp psi_i + h d_k^top J_(t,i) v^+ >= 0, quad
  0 <= psi_i perp f_i gamma_i - sum_k beta_(i k) >= 0, quad d_k "four edges of a pyramid"
q_"goal" "turns by" psi "about" z "after a quarter turn about" y "where the cube is tipped"
e = norm(p - p_"goal")^2 + 4 w_q norm("turn"(q_"goal", q))^2
"turn, the vector part of the quaternion that turns one to the other"
min sum_(k=0)^(N-1) w_c norm(c_k - t_k)^2 + w_"end" e_N
"""
golden = {"exact": Golden(0.02728969294, settings={"strategy": "scholtes"}, tried=2, note="another minimum: 0.0276413")}


class Params(Parameters):
    """Parameters of ``push-cube``."""

    a: float = quantity(0.2, "m", "side of the cube", above=0)
    m: float = quantity(1.0, "kg", "mass of the cube", above=0)
    r: float = quantity(0.03, "m", "radius of the fingertip", above=0)
    K: float = quantity(100.0, "N/m", "stiffness of the fingertip's servos", above=0)
    friction: float = quantity(0.6, "1", "Coulomb's coefficient of cube and table", above=0)
    grip: float = quantity(0.9, "1", "Coulomb's coefficient of cube and fingertip", above=0)
    g: float = quantity(9.81, "m/s^2", "gravity", above=0)
    h: float = quantity(0.05, "s", "step size", above=0)
    N: int = structure(20, "number of steps", least=1)
    turn: str = choice(("flat", "over"), "the cube stays flat, or is tipped over by a quarter turn")
    x0: float = quantity(-0.2, "m", "start of the fingertip, x; the cube's middle is at 0")
    y0: float = quantity(0.0, "m", "start of the fingertip, y")
    z0: float = quantity(0.15, "m", "start of the fingertip, z; the table is at 0")
    goal_x: float = quantity(0.3, "m", "goal of the cube's middle, x")
    goal_y: float = quantity(0.0, "m", "goal of the cube's middle, y")
    yaw: float = quantity(0.5, "rad", "goal of the cube's rotation about z")
    w_q: float = quantity(0.1, "m^2/rad^2", "weight of the rotation to the goal", least=0)
    w_end: float = quantity(10.0, "1/m^2", "terminal weight of the distance to the goal", least=0)
    w_c: float = quantity(0.1, "1/m^2", "weight of commands away from the fingertip", least=0)

    @model_validator(mode="after")
    def _tip_starts_free(self) -> Params:
        x, y, z = abs(self.x0), abs(self.y0), abs(self.z0 - self.a / 2)
        gap = math.hypot(*(max(coordinate - self.a / 2, 0.0) for coordinate in (x, y, z))) - self.r
        if gap < 0 or self.z0 < 0:
            raise ValueError(
                f"the fingertip starts inside the cube or below the table, at ({self.x0:g},"
                f" {self.y0:g}, {self.z0:g}) m; move x0, y0 or z0 away"
            )
        return self


def fingertip(name: str, stiffness: Number) -> tuple[Body, ...]:
    """Return the bodies of a fingertip: slides along x, y and z with servos; the last body, ``<name>z``, is the tip."""
    x, y, z = (f"{name}{axis}" for axis in "xyz")
    return (
        Body(x, None, 0.0, joint="slide", axis=(1.0, 0.0, 0.0), servo=stiffness),
        Body(y, x, 0.0, joint="slide", axis=(0.0, 1.0, 0.0), servo=stiffness),
        Body(z, y, 0.0, joint="slide", axis=(0.0, 0.0, 1.0), servo=stiffness),
    )


def machine(p: ParameterTable | Mapping[str, float]) -> SpatialMachine:
    """Return the machine of cube, fingertip and table; its parameters are numbers or symbols."""
    a, m = p["a"], p["m"]
    return SpatialMachine(
        (Body("cube", None, m, (m * a**2 / 6,) * 3, joint="free"), *fingertip("tip", p["K"])),
        (
            SpatialPart("table", "world", Plane()),
            SpatialPart("cube", "cube", Box((a / 2, a / 2, a / 2))),
            SpatialPart("tip", "tipz", Sphere(p["r"])),
        ),
        (("cube", "table"), ("cube", "tip")),
        gravity=(0.0, 0.0, -p["g"]),
    )


def goal_turn(yaw: ca.SX, over: bool) -> ca.SX:
    """Return the goal's unit quaternion (4, 1): ``yaw`` [rad] about z, after a quarter turn about y if ``over``."""
    about_z = ca.vertcat(ca.cos(yaw / 2), 0, 0, ca.sin(yaw / 2))
    return rotation.product(about_z, ca.SX([math.sqrt(0.5), 0, math.sqrt(0.5), 0])) if over else about_z


def turn_between(first: ca.SX, second: ca.SX) -> ca.SX:
    """Return the squared angle between two unit quaternions as ``4 sin^2(angle / 2)`` [rad^2]."""
    inverse = ca.vertcat(first[0], -first[1:])
    return 4 * ca.sumsqr(rotation.product(inverse, second)[1:])


def build(params: Params) -> Problem:
    """Return the problem with steps (push-cube.2) to (push-cube.4), and cost (push-cube.10).

    The contact is (push-cube.5) and (push-cube.6), the error in the cost (push-cube.8). The gap is the
    true distance, the state is (q, v). Inputs are commanded positions [m], which a fingertip without
    contact reaches in one step; lam is in N s.
    """
    p = table(params)
    corners = ca.repmat(p["friction"], 8)
    system = machine(p).system(name, p, h=p["h"], friction=ca.vertcat(corners, p["grip"]), inertial=False)
    tip = ca.vertcat(p["x0"], p["y0"], p["z0"])
    goal = ca.vertcat(p["goal_x"], p["goal_y"], p["a"] / 2)
    x = system.x
    squared_turn = turn_between(goal_turn(p["yaw"], params.turn == "over"), x[3:7])
    return pose_problem(
        params,
        system,
        stage_cost=p["w_c"] * ca.sumsqr(system.u - x[7:10]),
        terminal_cost=p["w_end"] * (ca.sumsqr(x[:3] - goal) + p["w_q"] * squared_turn),
        x0=ca.vertcat(0, 0, p["a"] / 2, 1, 0, 0, 0, tip, ca.SX.zeros(9)),
        guess=partial(_carried_along, over=math.pi / 2 if params.turn == "over" else 0.0),
        scaling=Scaling(impulse=0.5, gap=0.1),
    )


def _carried_along(problem: Problem, p: np.ndarray, over: float) -> tuple[np.ndarray, np.ndarray]:
    """Return a guess in which the cube moves evenly to its goal, tilted by ``over`` [rad], with the tip behind it."""
    values, N = problem.parameters.unpack(p), problem.N
    a, s = values["a"], np.linspace(0, 1, N + 1)
    X = np.tile(problem.initial_states(p)[0], (N + 1, 1))
    height = (0.35 if over else 0.0) * a
    for k, share in enumerate(s):
        tilt, yaw = share * over / 2, share * values["yaw"] / 2
        orientation = rotation.product(
            ca.SX([math.cos(yaw), 0, 0, math.sin(yaw)]), ca.SX([math.cos(tilt), 0, math.sin(tilt), 0])
        )
        R = rotation.matrix(orientation)
        X[k, 3:7] = np.array(ca.evalf(orientation)).ravel()
        X[k, :3] = share * values["goal_x"], share * values["goal_y"], a / 2
        if over:
            back = np.array(ca.evalf(R @ ca.SX([-a / 2, 0, a / 2]))).ravel()
            X[k, :3] += back + np.array([a / 2 - share * a, 0.0, -a / 2])
        behind = R @ ca.SX([-a / 2 - values["r"], 0, height])
        X[k, 7:10] = X[k, :3] + np.array(ca.evalf(behind)).ravel()
    X[0, 7:10] = problem.initial_states(p)[0][7:10]
    X[1:, 10:13] = np.diff(X[:, :3], axis=0) / values["h"]
    X[1:, 16:19] = np.diff(X[:, 7:10], axis=0) / values["h"]
    return X, X[1:, 7:10] + 0.02


@cache
def _with_goal(dumped: str) -> SpatialMachine:
    params = Params.model_validate_json(dumped)
    position = ca.SX([params.goal_x, params.goal_y, params.a / 2])
    quaternion = goal_turn(ca.SX(params.yaw), params.turn == "over")
    return with_goal(machine(params.model_dump()), "cube", position, quaternion)


def with_goal(original: SpatialMachine, body: str, position: ca.SX, quaternion: ca.SX) -> SpatialMachine:
    """Return the machine with a fixed copy of ``body``, called goal, at ``position`` [m] and ``quaternion`` (4, 1)."""
    x, y, z, *q = (float(v) for v in ca.vertsplit(ca.evalf(ca.vertcat(position, quaternion))))
    goal = Body("goal", None, 0.0, joint="fixed", position=(x, y, z), quaternion=(q[0], q[1], q[2], q[3]))
    goal_parts = (SpatialPart(f"goal {part.name}", "goal", part.shape) for part in original.parts if part.body == body)
    return replace(
        original,
        bodies=(*original.bodies, goal),
        parts=(*original.parts, *goal_parts),
    )


def seen_with_goal(
    machine_with_goal: SpatialMachine, camera: PinholeCamera, state: np.ndarray, tips: set[str]
) -> list[Shape]:
    """Draw a machine whose bodies ``tips`` are fingertips, with a transparent goal."""
    visible = [
        replace(shape, shade=0.0) if shape.role == "goal" and isinstance(shape, Circle | Outline) else shape
        for shape in spatial_shapes(machine_with_goal, camera, state, tips, {"goal"})
    ]
    return sorted(visible, key=lambda shape: shape.role == "goal" and isinstance(shape, Outline))


def _camera(params: Params) -> PinholeCamera:
    middle = (params.goal_x / 2, params.goal_y / 2, 0.3 * params.a)
    size = math.hypot(params.goal_x, params.goal_y) + 2.5 * params.a
    return PinholeCamera.around(middle, size, elevation=0.45)


def draw(params: Params, state: np.ndarray) -> list[Shape]:
    """Draw cube, fingertip and table, and the cube's goal."""
    return seen_with_goal(_with_goal(params.model_dump_json()), _camera(params), state, {"tipz"})


def frames(params: Params, state: np.ndarray) -> list[ContactFrame]:
    """Return the contact frames of every corner on the table, and of the fingertip on the cube."""
    picture = _with_goal(params.model_dump_json()), _camera(params), state
    return [*spatial_frames(*picture, params.friction)[:-1], spatial_frames(*picture, params.grip)[-1]]
