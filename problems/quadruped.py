"""A quadruped in space: stand up from the floor, trot, or jump."""

from __future__ import annotations

import casadi as ca
import numpy as np

from ocp.problem import Guess, Problem, Scaling
from problems.drawing import ContactFrame, Shape
from problems.machines.perspective import Camera
from problems.machines.quadruped import LEGS, TRUNK, height, pose
from problems.machines.quadruped import quadruped as machine_of
from problems.machines.spatial import AXES, spatial_frames, spatial_shapes
from problems.parameters import Parameters, choice, quantity, structure, table
from problems.spec import Citation

name = "quadruped"
title = "Quadruped: stand up, trot or jump"
citation = Citation("stewart1996implicit", "time stepping; the machine is our own")
axes = AXES
equations = r"""
M(q) (v^+ - v) = h (B u - C(q, v) v^+ - g(q) - D v^+) + J_n^top gamma + J_t^top beta + J_l^top nu
q^+ = q plus.circle h v^+, quad q "= (place, quaternion, joints), 12 motors"
0 <= gamma perp phi(q^+) >= 0, quad 0 <= nu perp "joint limits" >= 0
0 <= beta_k perp psi + h d_k^top J_t v^+ >= 0, quad 0 <= psi perp f gamma - sum beta_k >= 0
min sum_(k=0)^(N-1) h (w_u norm(u_k)^2 + w_v norm(v_k)^2)
  + w_"place" norm(p_N - p_"end")^2 + w_"turn" norm(e_N - e_"end")^2
  + w_"joints" norm(theta_N - theta_"end")^2 + w_"rest" norm(v_N)^2
p, e "place and quaternion of the trunk," theta "the joints"
"""
_THIGH, _SHIN = 0.8, -1.6
_FOLDED = 2.6
"""Angles of a leg that stands, and of a folded one, whose foot is on the floor beside the belly."""
_LYING = TRUNK[2] + 1e-4
_STANDS = pose(0.0, height(_THIGH, _SHIN), _THIGH, _SHIN)
_CAMERA = Camera.around((0.25, 0.0, 0.2), 0.75)


class Params(Parameters):
    """Parameters of ``quadruped``."""

    start: str = choice(("stand", "lie"), "on its feet, or on its belly with folded legs")
    distance: float = quantity(0.5, "m", "way of the trunk along x")
    rise: float = quantity(0.0, "m", "height of the trunk at the end above where it stands")
    turn: float = quantity(0.0, "rad", "turn of the trunk about z")
    friction: float = quantity(0.8, "1", "Coulomb's coefficient with the ground", above=0)
    h: float = quantity(0.03, "s", "step size", above=0)
    N: int = structure(20, "number of steps", least=1)
    edges: str = choice(("4", "8"), "of the pyramid of friction")
    u_max: float = quantity(1.0, "1", "largest input, a unit is 25 N m", above=0)
    w_u: float = quantity(0.1, "1/s", "weight of the inputs", least=0)
    w_v: float = quantity(0.01, "s/m^2", "weight of the velocities", least=0)
    w_place: float = quantity(20.0, "1/m^2", "terminal weight of the trunk's place", least=0)
    w_turn: float = quantity(5.0, "1", "terminal weight of the trunk's turn", least=0)
    w_joints: float = quantity(1.0, "1/rad^2", "terminal weight of the joints", least=0)
    w_rest: float = quantity(0.1, "s^2/m^2", "terminal weight of the velocities", least=0)


def _start(params: Params) -> np.ndarray:
    """q at the start."""
    return pose(0.0, _LYING, _FOLDED, -_FOLDED) if params.start == "lie" else _STANDS


def _end(distance: ca.SX | float, rise: ca.SX | float, turn: ca.SX | float) -> ca.SX:
    """q at the end."""
    end = ca.SX(_STANDS)
    end[0] += distance
    end[2] += rise
    end[3], end[6] = ca.cos(turn / 2), ca.sin(turn / 2)
    return end


def build(params: Params) -> Problem:
    """Steps (quadruped.1) on the tangent space (quadruped.2) with contacts (quadruped.3) and
    friction (quadruped.4); state (q, v), impulses lam [N s].

    To jump, give a ``rise``; to stand up, ``start=lie`` and no distance.
    """
    p, machine = table(params), machine_of(belly=params.start == "lie")
    system = machine.system(name, p, h=p["h"], friction=p["friction"], edges=int(params.edges))
    q, v = system.x[:19], system.x[19:]
    end = _end(p["distance"], p["rise"], p["turn"])
    off = q - end
    return Problem(
        name=name,
        system=system,
        N=params.N,
        stage_cost=p["h"] * (p["w_u"] * ca.sumsqr(system.u) + p["w_v"] * ca.sumsqr(v)),
        terminal_cost=p["w_place"] * ca.sumsqr(off[:3]) + p["w_turn"] * ca.sumsqr(off[3:7])
        + p["w_joints"] * ca.sumsqr(off[7:]) + p["w_rest"] * ca.sumsqr(v),
        x0=ca.vertcat(_start(params), ca.SX.zeros(18)),
        parameters=p,
        u_lower=-p["u_max"],
        u_upper=p["u_max"],
        guess=_trot(_start(params)),
        scaling=Scaling(impulse=1.0, gap=0.1, x=0.1, u=0.3),
        settings={"strategy": "scholtes-quick"},
    )  # fmt: skip


def _trot(start: np.ndarray) -> Guess:
    """From start to end along a straight way, diagonal legs lifted in turn where it is long."""

    def guess(problem: Problem, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        share, values = np.linspace(0, 1, problem.N + 1)[:, None], problem.parameters.unpack(p)
        end = np.array(ca.DM(_end(values["distance"], values["rise"], values["turn"]))).ravel()
        X = np.zeros((problem.N + 1, problem.system.nx))
        X[:, :19] = (1 - share) * start + share * end
        for k, (fore, left) in enumerate(LEGS.values()):
            swing = np.sin(4 * np.pi * share[:, 0]) * fore * left
            lift = min(1.0, abs(values["distance"])) * np.maximum(0.0, swing)
            X[:, 8 + 3 * k] += lift
            X[:, 9 + 3 * k] -= 2 * lift
        return X, np.zeros((problem.N, problem.system.nu))

    return guess


def draw(params: Params, state: np.ndarray) -> list[Shape]:
    """Trunk, legs and the floor."""
    return spatial_shapes(machine_of(), _CAMERA, state)


def frames(params: Params, state: np.ndarray) -> list[ContactFrame]:
    """Contacts with the floor."""
    machine = machine_of(belly=params.start == "lie")
    return spatial_frames(machine, _CAMERA, state, params.friction)
