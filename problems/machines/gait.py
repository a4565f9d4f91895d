"""Problems of moving a robot in space from one pose to another."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np

from dynamics.systems.space import SpatialMachine
from ocp.problem.problem import Guess, Problem, Scaling
from problems.machines.footfalls import FootfallParams, footfall_cost
from problems.parameters import choice, pose_problem, quantity, structure, table

STEPS = r"""
M(q) (v^+ - v) = h (B u - C(q, v) v^+ - g(q) - D v^+) + J_n^top gamma + J_t^top beta + J_l^top nu
q^+ = q ⊕ h v^+, quad q "= (place, quaternion, joints)"
0 <= gamma perp phi(q^+) >= 0, quad 0 <= nu perp "joint limits" >= 0
0 <= beta_k perp psi + h d_k^top J_t v^+ >= 0, quad 0 <= psi perp f gamma - sum beta_k >= 0
min sum_(k=0)^(N-1) h (w_u norm(u_k)^2 + w_v norm(v_k)^2)
  + w_"place" norm(p_N - p_"end")^2 + w_"turn" norm(e_N - e_"end")^2
  + w_"joints" norm(theta_N - theta_"end")^2 + w_"rest" norm(v_N)^2
  + sum_(k=0)^(N-1) sum_i (w_"slip" f gamma_i psi_i \/ h + h w_"clear" max(0, 1 - phi_i/c)^2 norm(J_(t,i) v_k)^2)
p, e "place and quaternion of the trunk," theta "the joints," c "the clearance"
"""
"""Equations of the problems that :func:`gait` builds, in the mathematical notation of typst."""


class GaitParams(FootfallParams):
    """Parameters of a problem in which a robot moves to another pose."""

    distance: float = quantity(0.5, "m", "distance of the trunk along x")
    rise: float = quantity(0.0, "m", "height of the trunk at the end, above its standing height")
    turn: float = quantity(0.0, "rad", "rotation of the trunk about z")
    friction: float = quantity(0.8, "1", "Coulomb's coefficient with the ground", above=0)
    h: float = quantity(0.03, "s", "step size", above=0)
    N: int = structure(20, "number of steps", least=1)
    edges: str = choice(("4", "8"), "number of edges of the friction pyramid")
    u_max: float = quantity(1.0, "1", "largest input, in units of the gears", above=0)
    w_u: float = quantity(0.1, "1/s", "weight of the inputs", least=0)
    w_v: float = quantity(0.01, "s/m^2", "weight of the velocities", least=0)
    w_place: float = quantity(20.0, "1/m^2", "terminal weight of the trunk's position", least=0)
    w_turn: float = quantity(5.0, "1", "terminal weight of the trunk's rotation", least=0)
    w_joints: float = quantity(1.0, "1/rad^2", "terminal weight of the joints", least=0)
    w_rest: float = quantity(0.1, "s^2/m^2", "terminal weight of the velocities", least=0)


def gait(
    name: str,
    params: GaitParams,
    machine: SpatialMachine,
    start: np.ndarray,
    stands: np.ndarray,
    swing: Callable[[np.ndarray], np.ndarray],
    scaling: Scaling,
) -> Problem:
    """Build the problem of moving from the pose ``start`` to the pose ``stands``, translated and rotated.

    Translation and rotation are parameters. The first seven entries of a pose q are position and quaternion of the
    trunk. ``swing`` maps fractions (n,) of the path to angles (n, joints), which are added to the joints
    of the guess, scaled down for a path below 1 m.
    """
    p = table(params)
    system = machine.system(name, p, h=p["h"], friction=p["friction"], edges=int(params.edges))
    nq = machine.tree().nq
    q, v = system.x[:nq], system.x[nq:]
    error = q - _end(stands, p["distance"], p["rise"], p["turn"])
    return pose_problem(
        params,
        system,
        stage_cost=p["h"] * (p["w_u"] * ca.sumsqr(system.u) + p["w_v"] * ca.sumsqr(v))
        + footfall_cost(params, p, system),
        terminal_cost=p["w_place"] * ca.sumsqr(error[:3])
        + p["w_turn"] * ca.sumsqr(error[3:7])
        + p["w_joints"] * ca.sumsqr(error[7:])
        + p["w_rest"] * ca.sumsqr(v),
        x0=ca.vertcat(start, ca.SX.zeros(v.numel())),
        guess=_straight(start, stands, swing),
        scaling=scaling,
    )


def _end(stands: np.ndarray, distance: ca.SX | float, rise: ca.SX | float, turn: ca.SX | float) -> ca.SX:
    """Return the goal pose q: ``stands``, moved by ``distance`` along x and ``rise`` along z, rotated by ``turn``."""
    end = ca.SX(stands)
    end[0] += distance
    end[2] += rise
    end[3], end[6] = ca.cos(turn / 2), ca.sin(turn / 2)
    return end


def _straight(start: np.ndarray, stands: np.ndarray, swing: Callable[[np.ndarray], np.ndarray]) -> Guess:
    """Return a straight-line guess from start to goal, with ``swing`` times min(1, |distance|) added to joints."""

    def guess(problem: Problem, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        share, values = np.linspace(0, 1, problem.N + 1), problem.parameters.unpack(p)
        changes = (values[key] for key in ("distance", "rise", "turn"))
        end = np.array(ca.DM(_end(stands, *changes))).ravel()
        X = np.zeros((problem.N + 1, problem.system.nx))
        X[:, : len(end)] = np.outer(1 - share, start) + np.outer(share, end)
        X[:, 7 : len(end)] += min(1.0, abs(values["distance"])) * swing(share)
        return X, np.zeros((problem.N, problem.system.nu))

    return guess
