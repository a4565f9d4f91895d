"""Steps of arena tasks: by the next velocity, and variational midpoint steps, implicit in the next velocity."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca

from dynamics.systems import ContactSystem
from ocp.problem.problem import Constraint, Problem, Scaling
from problems.parameters import Parameters, pose_problem


@dataclass(frozen=True)
class Midpoint:
    """Steps of size h [s] of a machine with mass matrix ``mass(q)`` and ``bias(q, v)`` (velocity terms, gravity).

    With v+ = (q+ - q)/h and the midpoints m- = q - h v/2, m+ = q + h v+/2 the balance of momentum is
    ``M(m+) v+ - M(m-) v + h/2 (bias(m+, v+) + bias(m-, v)) = impulse``.
    """

    mass: Callable[[ca.SX], ca.SX]
    bias: Callable[[ca.SX, ca.SX], ca.SX]
    h: ca.SX

    def momentum_change(self, q: ca.SX, v: ca.SX, v_next: ca.SX) -> ca.SX:
        """Return the left side of the balance (nq, 1) [N s or N m s]."""
        before, after = q - self.h * v / 2, q + self.h * v_next / 2
        momentum = self.mass(after) @ v_next - self.mass(before) @ v
        return momentum + self.h / 2 * (self.bias(after, v_next) + self.bias(before, v))


def semi_implicit(x: ca.SX, x_next: ca.SX, v_next: ca.SX, h: ca.SX) -> ca.SX:
    """Return the residual of steps ``q+ = q + h v+`` of states x = (q, v) to x+."""
    return x_next - ca.vertcat(x[: v_next.numel()] + h * v_next, v_next)


def pose_swing_up(
    params: Parameters, system: ContactSystem, balance: ca.SX, goal: ca.SX | ca.DM, largest: ca.SX
) -> Problem:
    """Return a swing-up from rest at zero to the poses ``goal``, with ``balance`` = 0 at each step.

    The first input is at most ``largest``; the cost is ``sum w_u h u_0² + w_end |q_N - goal|² + w_v |v_N|²``.
    """
    p, x, u = system.parameters, system.x, system.u
    return pose_problem(
        params,
        system,
        stage_cost=p["w_u"] * p["h"] * u[0] ** 2,
        terminal_cost=p["w_end"] * ca.sumsqr(x[:2] - goal) + p["w_v"] * ca.sumsqr(x[2:]),
        x0=ca.SX.zeros(4),
        u_lower=ca.vertcat(-largest, -ca.inf, -ca.inf),
        u_upper=ca.vertcat(largest, ca.inf, ca.inf),
        path=[Constraint("momentum", balance, 0.0, 0.0)],
        scaling=Scaling(impulse=1.0, gap=0.5, x=1.0, u=1.0),
    )
