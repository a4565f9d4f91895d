"""Problem of the half-cheetah: running in a periodic gait at a given mean speed."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
from pydantic import model_validator

from dynamics.systems.contact_rows import Cone
from ocp.problem.problem import Constraint, FreeStart, Problem, Scaling
from problems.bodies.half_cheetah.machine import half_cheetah
from problems.drawing import ContactFrame, Shape
from problems.machines.machine import machine_frames, machine_shapes
from problems.parameters import Parameters, choice, friction_of, pose_problem, quantity, structure, table
from problems.spec import Citation, Golden, smoothed

name = "half-cheetah"
title = "Half-cheetah: a periodic gait at a given speed"
citation = Citation("zhang2023adaptive", "Adaptive barrier smoothing, sec. 7; tables of Dojo's cheetah")
axes = ("x [m]", "z [m]")
equations = """
M(q) (v^+ - v) = h (B u - b(q, v) - D v^+ - K q^+) + J_n^top gamma + J_t^top (beta^+ - beta^-)
  + J_l^top nu, quad q^+ = q + h v^+
q "= (x, z, pitch, three joints of the hind leg, three of the fore leg), angles clockwise"
M "masses," b "gravity and centrifugal forces," B "motors," D, K "dampers and springs of the joints"
gamma, beta^plus.minus "normal and friction impulses of spheres," nu "of the joints' limits"
0 <= gamma perp phi(q^+) >= 0, quad 0 <= beta^plus.minus perp psi plus.minus h J_t v^+ >= 0, quad
  0 <= psi perp f gamma - beta^+ - beta^- >= 0
0 <= nu perp "way to a joint's limit" >= 0, quad f "the coefficient of friction"
phi "height of a sphere above the ground," psi "the way it slides in a step, against friction"
min 1 / N sum_(k=0)^(N-1) (w_u norm(u_k)^2 + w_v norm(v_k)^2), quad abs(u) <= u_"max"
"over a stride," x_N = x_0 + ("speed" N h, 0, dots); "start and step size" h "are chosen too"
"""
SPHERES = {
    "legs": ("bshin", "bfoot", "fshin", "ffoot"),
    "all": ("fore end", "hind end", "head", *(f"{end}{link}" for end in "bf" for link in ("thigh", "shin", "foot"))),
    "feet": ("bfoot", "ffoot"),
}
"""Mapping from a value of the parameter ``spheres`` to the spheres that can touch the ground."""

golden = {
    "exact": Golden(
        0.0498015233,
        tried=2,
        note="0.0497311 was certified once; other minima: 0.0504196, 0.0504588, 0.0513791",
    ),
    "barrier mu=1e-3": smoothed(0.0402715748, tried=1),
}
MACHINE = half_cheetah()
"""The machine with default parameters, for drawings."""


class Params(Parameters):
    """Parameters of ``half-cheetah``."""

    speed: float = quantity(1.0, "m/s", "mean speed of the gait")
    N: int = structure(24, "number of steps of a stride", least=2)
    h_min: float = quantity(0.005, "s", "smallest step size", above=0)
    h_max: float = quantity(0.025, "s", "largest step size", above=0)
    friction: float = quantity(0.4, "1", "Coulomb's coefficient with the ground", least=0)
    damping: float = quantity(1.0, "N m s/rad", "damping of each joint", least=0)
    base_damping: float = quantity(0.0, "N s/m", "drag on the torso, physically 0", least=0)
    u_max: float = quantity(1.0, "1", "largest input, in units of 30 to 120 N m; exceeded in the source", above=0)
    spheres: str = choice(tuple(SPHERES), "which parts may touch: shins and feet, all nine, or the feet")
    cone: Cone = choice(("linearised", "second-order"), "friction's cone: beta± and psi, or its eigenvalues")
    limits: int = structure(1, "1 for joint limits, 0 for none", most=1)
    w_u: float = quantity(1.0, "1", "weight of the inputs", least=0)
    w_v: float = quantity(1e-3, "s^2/m^2", "weight of the velocities", least=0)

    @model_validator(mode="after")
    def _steps_are_possible(self) -> Params:
        if self.h_min > self.h_max:
            raise ValueError(
                f"the least step size, h_min = {self.h_min:g} s, is above the largest, h_max ="
                f" {self.h_max:g} s; lower the one or raise the other"
            )
        return self


def build(params: Params) -> Problem:
    """Return the problem with steps (half-cheetah.1), contacts (half-cheetah.5); state (q, v, h), lam in N s."""
    p, friction = friction_of(table(params))
    step = ca.SX.sym("h")
    machine = half_cheetah(base_damping=p["base_damping"], damping=p["damping"], limits=bool(params.limits))
    system = machine.system(
        name, p, h=step, friction=friction, spheres=SPHERES[params.spheres], free_step=True, cone=params.cone
    )
    x, nx = system.x, system.nx
    nq = nx // 2
    pose = np.array(machine.pose)
    middle = ca.sqrt(p["h_min"] * p["h_max"])
    low, high = -np.full(nq, np.inf), np.full(nq, np.inf)
    low[:3], high[:3] = [0.0, 0.3, -0.5], [0.0, 0.8, 0.5]
    at_rest = ca.vertcat(ca.DM(pose), p["speed"], ca.DM.zeros(nq - 1), middle)
    running = p["w_u"] * ca.sumsqr(system.u) + p["w_v"] * ca.sumsqr(x[nq : 2 * nq])
    stride_error = x[0] - p["speed"] * params.N * x[nx - 1]
    return pose_problem(
        params,
        system,
        stage_cost=running / params.N,
        terminal_cost=ca.SX(0),
        x0=at_rest,
        terminal=[Constraint("stride", stride_error, 0, 0)],
        start=FreeStart(
            lower=ca.vertcat(ca.DM(low), ca.DM(-np.full(nq, np.inf)), p["h_min"]),
            upper=ca.vertcat(ca.DM(high), ca.DM(np.full(nq, np.inf)), p["h_max"]),
            periodic=tuple(range(1, 2 * nq)),
        ),
        guess=_glide,
        scaling=Scaling(impulse=2.0, gap=0.1, x=0.1, u=0.1),
    )


def _glide(problem: Problem, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a guess that slides forward in the standing pose, at the speed of the start."""
    N, nx = problem.N, problem.system.nx
    start = problem.initial_states(p)[0]
    X = np.tile(start, (N + 1, 1))
    X[:, 0] = start[nx // 2] * start[-1] * np.arange(N + 1)
    return X, np.zeros((N, problem.system.nu))


def draw(params: Any, state: np.ndarray) -> list[Shape]:
    """Draw links, spheres and the ground."""
    return machine_shapes(MACHINE, state)


def frames(params: Any, state: np.ndarray) -> list[ContactFrame]:
    """Return the contact frame of each sphere on the ground; joint limits have none."""
    return machine_frames(MACHINE, state, SPHERES[params.spheres], params.friction)
