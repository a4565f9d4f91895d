"""Problem of a one-legged planar hopper: hopping forward and landing at rest."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
from pydantic import model_validator

from dynamics.systems.contact_rows import Cone
from ocp.problem.problem import Problem, Scaling
from problems.bodies.hopper.machine import hopper
from problems.drawing import ContactFrame, Mark, Shape
from problems.machines.machine import machine_frames, machine_shapes
from problems.parameters import Parameters, choice, friction_of, pose_problem, quantity, structure, table
from problems.spec import Citation, Golden, smoothed

name = "hopper"
title = "Hopper: hop forward and land at rest"
citation = Citation("zhang2023adaptive", "Adaptive barrier smoothing, sec. 7; tables of Dojo's hopper")
axes = ("x [m]", "z [m]")
equations = """
M(q) (v^+ - v) = h (B u - b(q, v) - D v^+ - K q^+) + J_n^top gamma + J_t^top (beta^+ - beta^-)
q^+ = q + h v^+, quad q "= (x, z, pitch, thigh, leg, foot), angles clockwise; x, z of the torso"
M "masses," b "gravity and centrifugal forces," B "motors," D, K "dampers and springs of the joints"
gamma, beta^plus.minus "normal and friction impulses of each sphere on the ground"
0 <= gamma perp phi(q^+) >= 0, quad 0 <= beta^plus.minus perp psi plus.minus h J_t v^+ >= 0, quad
  0 <= psi perp f gamma - beta^+ - beta^- >= 0
phi "height of a sphere above the ground," psi "the way it slides in a step, against friction" f
min sum_(k=0)^(N-1) h (w_u norm(u_k)^2 + w_v norm(v_k)^2) + w_"end" norm(q_N - q_"end")^2
  + w_"rest" norm(v_N)^2
q_"end" "upright at" x = "goal", quad abs(u) <= u_"max"
"""

golden = {
    "exact": Golden(0.0502015625, tried=13, note="other minima: 0.0505520, 0.0509175, 0.0516220"),
    "barrier mu=1e-3": smoothed(0.0514836513, tried=1),
}
MACHINE = hopper()
"""The machine with default parameters, for drawings."""
STANDING_HEIGHT = 1.21
"""Height of the torso [m] of the hopper standing upright, as at the goal."""
SPHERES = {
    "outer": ("torso", "leg", "toe", "heel"),
    "all": ("torso", "thigh", "leg", "toe", "heel"),
    "foot": ("toe", "heel"),
}
"""Mapping from a value of the parameter ``spheres`` to the spheres that can touch the ground."""


class Params(Parameters):
    """Parameters of ``hopper``."""

    h: float = quantity(0.025, "s", "step size", above=0)
    N: int = structure(60, "number of steps", least=1)
    goal: float = quantity(1.0, "m", "distance to hop")
    friction: float = quantity(1.0, "1", "Coulomb's coefficient with the ground", least=0)
    spring: float = quantity(10.0, "N m/rad", "stiffness of each joint", least=0)
    damping: float = quantity(1.0, "N m s/rad", "damping of each joint", least=0)
    base_damping: float = quantity(0.0, "N s/m", "drag on the torso; 50 in the source as parsed, physically 0", least=0)
    u_max: float = quantity(1.0, "1", "largest input, in units of 200 N m; the source has no bound", above=0)
    spheres: str = choice(tuple(SPHERES), "which parts may touch: all but the hip, all, or toe and heel")
    cone: Cone = choice(("linearised", "second-order"), "friction's cone: beta± and psi, or its eigenvalues")
    limits: int = structure(0, "1 for joint limits, as in the source's later version", most=1)
    z0: float = quantity(1.21, "m", "height of the torso at the start; 1.21 stands on the ground")
    pitch0: float = quantity(0.0, "rad", "angle of the torso at the start")
    thigh0: float = quantity(0.0, "rad", "angle of the thigh in its joint at the start")
    leg0: float = quantity(0.0, "rad", "angle of the leg in its joint at the start")
    foot0: float = quantity(0.0, "rad", "angle of the foot in its joint at the start")
    w_u: float = quantity(1.0, "1/s", "weight of the inputs", least=0)
    w_end: float = quantity(100.0, "1/m^2", "terminal weight of position and posture", least=0)
    w_rest: float = quantity(1.0, "s^2/m^2", "terminal weight of the velocities", least=0)
    w_v: float = quantity(1e-3, "s/m^2", "weight of the velocities", least=0)

    @model_validator(mode="after")
    def _start_is_possible(self) -> Params:
        machine = hopper(limits=bool(self.limits))
        angles = [self.pitch0, self.thigh0, self.leg0, self.foot0]
        machine.check_start([0.0, self.z0, *angles], SPHERES[self.spheres])
        return self


def build(params: Params) -> Problem:
    """Return the problem with steps (hopper.1) and contacts (hopper.5); the state is (q, v), lam in N s."""
    p, friction = friction_of(table(params))
    machine = hopper(
        base_damping=p["base_damping"], spring=p["spring"], damping=p["damping"], limits=bool(params.limits)
    )
    system = machine.system(name, p, h=p["h"], friction=friction, spheres=SPHERES[params.spheres], cone=params.cone)
    x, nq = system.x, system.nx // 2
    angles = [p[f"{joint}0"] for joint in ("pitch", "thigh", "leg", "foot")]
    start = ca.vertcat(0, p["z0"], *angles, ca.SX.zeros(nq))
    end = ca.vertcat(p["goal"], STANDING_HEIGHT, ca.SX.zeros(2 * nq - 2))
    error = x - end
    running = p["w_u"] * ca.sumsqr(system.u) + p["w_v"] * ca.sumsqr(x[nq:])
    return pose_problem(
        params,
        system,
        stage_cost=p["h"] * running,
        terminal_cost=p["w_end"] * ca.sumsqr(error[:nq]) + p["w_rest"] * ca.sumsqr(error[nq:]),
        x0=start,
        guess=_glide,
        scaling=Scaling(impulse=5.0, gap=0.1, x=0.1, u=0.1),
    )


def _glide(problem: Problem, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a guess that slides upright from start to goal on a low arc."""
    position = problem.parameters.unpack(p)
    N, nx, nu = problem.N, problem.system.nx, problem.system.nu
    nq = nx // 2
    s = np.linspace(0, 1, N + 1)
    X = np.zeros((N + 1, nx))
    X[:, 0] = position["goal"] * s
    X[:, :nq] += (1 - s)[:, None] * problem.initial_states(p)[0][:nq]
    X[:, 1] += s * STANDING_HEIGHT + 4 * 0.1 * s * (1 - s)
    X[:, nq] = position["goal"] / (N * position["h"])
    return X, np.zeros((N, nu))


def draw(params: Params, state: np.ndarray) -> list[Shape]:
    """Draw links, spheres, the ground, and the goal."""
    return [*machine_shapes(MACHINE, state), Mark(params.goal, 0.0, "goal")]


def frames(params: Any, state: np.ndarray) -> list[ContactFrame]:
    """Return the contact frames of the spheres on the ground."""
    return machine_frames(MACHINE, state, SPHERES[params.spheres], params.friction)
