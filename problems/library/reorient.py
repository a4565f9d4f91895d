"""Three fingertips that turn a ball or a cube on a table, in space."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import cache

import casadi as ca
import numpy as np
from pydantic import model_validator

from dynamics.systems import ParameterTable
from dynamics.systems.space import Body, Box, Plane, SpatialMachine, SpatialPart, Sphere
from ocp.problem.problem import Problem, Scaling
from problems.drawing import ContactFrame, Shape
from problems.library.push_cube import fingertip, seen_with_goal, turn_between, with_goal
from problems.machines.perspective import PinholeCamera
from problems.machines.spatial import AXES, spatial_frames
from problems.parameters import Parameters, choice, pose_problem, quantity, structure, table
from problems.spec import Citation, Golden

name = "reorient"
title = "Three fingertips turn a ball or a cube on a table, in space"
citation = Citation("suh2023noising", "Noising data, sec. V, its quasi-dynamic model; task ours")
axes = AXES
equations = r"""
"object" o "at" p "with the unit quaternion" q, quad "fingertips" t_j, j = 1, 2, 3, quad
  c_j "commanded"
M v_o^+ = h (0, 0, -m g, 0, 0, 0) + J_(n,o)^top gamma + J_(t,o)^top beta, quad
  M = diag(m, m, m, I, I, I)
h K (t_j^+ - c_j) = J_(n,j)^top gamma + J_(t,j)^top beta
p^+ = p + h dot(p)^+, quad q^+ = q exp(h omega^+ \/ 2)
0 <= gamma_i perp phi_i >= 0, quad 0 <= beta_(i k) perp psi_i + h d_k^top J_(t,i) v^+ >= 0, quad
  0 <= psi_i perp f_i gamma_i - sum_k beta_(i k) >= 0
I = 2 m a^2 \/ 5 "of a ball of radius" a "," quad I = 2 m a^2 \/ 3 "of a cube with sides" 2 a
t_(j,0) "around the object, 120 degrees apart," quad norm(t_j - t_(j,0))_infinity <= "reach"
e = norm(p - p_0)^2 + 4 w_q norm("turn"(q_"goal", q))^2, quad
  q_"goal" = (cos theta \/ 2, bold(n) sin theta \/ 2)
"turn, the vector part of the quaternion that turns one to the other"
min sum_(k=0)^(N-1) w_c sum_j norm(c_(j,k) - t_(j,k))^2 + w_"end" e_N
"""
golden = {"exact": Golden(0.00348597807, settings={"strategy": "scholtes"}, tried=2, note="another minimum: 0.0037430")}
TIPS = ("thumb", "index", "middle")
"""Names of the fingertips."""
_START_OVERLAP = 0.01
"""Largest overlap of a fingertip with the object at the start, as a fraction of the fingertip's radius."""


class Params(Parameters):
    """Parameters of ``reorient``."""

    body: str = choice(("ball", "cube"), "object that is turned")
    axis: str = choice(("z", "x", "y"), "axis n of the rotation; z points up")
    a: float = quantity(0.1, "m", "radius of the ball, or half the side of the cube", above=0)
    m: float = quantity(0.5, "kg", "mass of the object", above=0)
    r: float = quantity(0.03, "m", "radius of the fingertips", above=0)
    K: float = quantity(100.0, "N/m", "stiffness of the fingertips' servos", above=0)
    friction: float = quantity(0.3, "1", "Coulomb's coefficient with the table", above=0)
    grip: float = quantity(0.9, "1", "Coulomb's coefficient with the fingertips", above=0)
    g: float = quantity(9.81, "m/s^2", "gravity", above=0)
    h: float = quantity(0.05, "s", "step size", above=0)
    N: int = structure(12, "number of steps", least=1)
    away: float = quantity(0.15, "m", "start of the fingertips, distance from the axis", above=0)
    z0: float = quantity(0.1, "m", "start of the fingertips, height above the table", least=0)
    reach: float = quantity(0.12, "m", "largest distance of a fingertip from its start, along each axis", above=0)
    goal: float = quantity(math.pi / 4, "rad", "angle to turn by")
    w_q: float = quantity(0.1, "m^2/rad^2", "weight of the rotation to the goal", least=0)
    w_end: float = quantity(100.0, "1/m^2", "terminal weight of the distance to the goal", least=0)
    w_c: float = quantity(1.0, "1/m^2", "weight of commands away from the fingertips", least=0)

    @model_validator(mode="after")
    def _tips_start_free(self) -> Params:
        offsets = np.asarray(_starts(self.away, self.z0 - self.a)).reshape(3, 3)
        if self.body == "ball":
            distances = np.linalg.norm(offsets, axis=1) - self.a
        else:
            distances = np.linalg.norm(np.maximum(np.abs(offsets) - self.a, 0), axis=1)
        # The default start is 0.1 mm too close to the cube; the first step moves it out.
        if distances.min() < (1 - _START_OVERLAP) * self.r:
            raise ValueError(f"a fingertip starts inside the {self.body}; make away larger than {self.away:g} m")
        return self


def _starts(away: ca.SX | float, z: ca.SX | float) -> ca.SX:
    """Return the start positions (9, 1) [m] of the fingertips: around the object, 120 degrees apart."""
    angles = (math.pi / 2 + 2 * math.pi / 3 * k for k in range(3))
    return ca.vertcat(*(ca.vertcat(away * math.cos(t), away * math.sin(t), z) for t in angles))


def machine(p: ParameterTable | Mapping[str, float], body: str) -> SpatialMachine:
    """Return the machine of object, fingertips and table; its parameters are numbers or symbols."""
    a, m = p["a"], p["m"]
    share, shape = (2 / 5, Sphere(a)) if body == "ball" else (2 / 3, Box((a, a, a)))
    fingers = [body for tip in TIPS for body in fingertip(tip, p["K"])]
    return SpatialMachine(
        (Body(body, None, m, (share * m * a**2,) * 3, joint="free"), *fingers),
        (
            SpatialPart("table", "world", Plane()),
            SpatialPart(body, body, shape),
            *(SpatialPart(tip, f"{tip}z", Sphere(p["r"])) for tip in TIPS),
        ),
        ((body, "table"), *((body, tip) for tip in TIPS)),
        gravity=(0.0, 0.0, -p["g"]),
    )


def _axis_rotation(axis: str, angle: ca.SX | float) -> ca.SX:
    """Return the unit quaternion (4, 1) of a rotation by ``angle`` [rad] about the world's x, y or z axis."""
    return ca.vertcat(ca.cos(angle / 2), ca.sin(angle / 2) * ca.SX(np.eye(3)["xyz".index(axis)]))


def build(params: Params) -> Problem:
    """Return the problem with steps (reorient.2) to (reorient.4), contact (reorient.5) and cost (reorient.10).

    The gap is the true distance, the state is (q, v). Inputs are commanded positions [m], which a
    fingertip without contact reaches in one step; lam is in N s.
    """
    p = table(params)
    resting = 1 if params.body == "ball" else 8
    coefficients = ca.vertcat(ca.repmat(p["friction"], resting), ca.repmat(p["grip"], 3))
    system = machine(p, params.body).system(name, p, h=p["h"], friction=coefficients, inertial=False)
    x, tips = system.x, _starts(p["away"], p["z0"])
    squared_turn = turn_between(_axis_rotation(params.axis, p["goal"]), x[3:7])
    position = ca.vertcat(0, 0, p["a"])
    free = ca.SX([ca.inf] * 7), ca.SX([ca.inf] * 15)
    return pose_problem(
        params,
        system,
        stage_cost=p["w_c"] * ca.sumsqr(system.u - x[7:16]),
        terminal_cost=p["w_end"] * (ca.sumsqr(x[:3] - position) + p["w_q"] * squared_turn),
        x0=ca.vertcat(position, 1, 0, 0, 0, tips, ca.SX.zeros(15)),
        x_lower=ca.vertcat(-free[0], tips - p["reach"], -free[1]),
        x_upper=ca.vertcat(free[0], tips + p["reach"], free[1]),
        scaling=Scaling(impulse=0.2, gap=0.1),
    )


@cache
def _with_goal(dumped: str) -> SpatialMachine:
    """Return the machine to draw, with its goal, and with marks on a ball that show its rotation."""
    params = Params.model_validate_json(dumped)
    pictured_machine, a = machine(params.model_dump(), params.body), params.a
    positions = ((0.0, 0.0, a), (a, 0.0, 0.0), (-a, 0.0, 0.0), (0.0, a, 0.0), (0.0, -a, 0.0))
    marks = (
        SpatialPart(f"mark {k}", "ball", Sphere(0.15 * a, position))
        for k, position in enumerate(positions)
        if params.body == "ball"
    )
    pictured_machine = replace(pictured_machine, parts=(*pictured_machine.parts, *marks))
    return with_goal(pictured_machine, params.body, ca.SX([0, 0, a]), _axis_rotation(params.axis, params.goal))


def _camera(params: Params) -> PinholeCamera:
    return PinholeCamera.around((0.0, 0.0, 0.8 * params.a), 2.6 * (params.away + params.r), elevation=0.6)


def draw(params: Params, state: np.ndarray) -> list[Shape]:
    """Draw object, fingertips and table, and the object's goal."""
    return seen_with_goal(_with_goal(params.model_dump_json()), _camera(params), state, {f"{tip}z" for tip in TIPS})


def frames(params: Params, state: np.ndarray) -> list[ContactFrame]:
    """Return the contact frames of the object on the table, and of every fingertip on the object."""
    picture = _with_goal(params.model_dump_json()), _camera(params), state
    return [*spatial_frames(*picture, params.friction)[:-3], *spatial_frames(*picture, params.grip)[-3:]]
