"""The three systems of pathologies, fig. 1: a dropped ball, a throw past a wall, a pivoted bar."""

from __future__ import annotations

import casadi as ca
import numpy as np

from dynamics.contact.interior_point import exact_scalar_solution
from dynamics.systems import ParameterTable, Signal
from ocp.gradients.objective import StaticObjective


def drop(step_height: float, start: float, g: float) -> StaticObjective:
    """Maximise where a ball ends that is dropped at x = theta over a step, -y [m].

    It falls freely until it would be below both levels; the inelastic landing is the exact law
    ``0 <= lam ⟂ y - ground + lam >= 0`` with ``ground = step_height`` for theta >= 0, else 0.
    """
    theta = ca.SX.sym("theta")
    long = np.sqrt(4 * start / g)
    ground = ca.if_else(theta >= 0, step_height, 0.0)
    free = start - g * long**2 / 2
    y = free + exact_scalar_solution(free - ground, ca.SX(1.0))
    return _objective("drop", theta, -y, "m", "where the ball is dropped")


def throw_wall(v0: float, distance: float, height: float, g: float) -> StaticObjective:
    """Throw a ball at angle theta past a wall that stops it: minimise -x² [m²].

    The ball lands at ``v0² sin(2 theta)/g`` unless it reaches the wall's face below its top; then
    it drops there, an inelastic impact.
    """
    theta = ca.SX.sym("theta")
    flight = 2 * v0**2 * ca.sin(theta) * ca.cos(theta) / g
    cosine = ca.if_else(ca.cos(theta) > 1e-9, ca.cos(theta), 1e-9)
    at_wall = distance * ca.sin(theta) / cosine - g * distance**2 / (2 * v0**2 * cosine**2)
    stopped = ca.logic_and(flight > distance, at_wall <= height)
    x = ca.if_else(stopped, distance, flight)
    return _objective("throw-wall", theta, -(x**2), "rad", "angle of the throw")


def pivot(v0: float, distance: float, length: float, mass: float, inertia: float
          ) -> StaticObjective:  # fmt: skip
    """Hit a bar that pivots at (distance, 0), to transfer angular momentum: -omega² [1/s²].

    The ball flies straight at angle theta and meets the bar, which reaches ``length`` to both
    sides, at the lever arm ``r = distance tan(theta)``. Frictionless plastic impact by the exact
    law on the approach: ``0 <= lam ⟂ -v_x + (1/mass + r²/inertia) lam >= 0``, omega = r lam /
    inertia. Beyond the tip it misses.
    """
    theta = ca.SX.sym("theta")
    arm = distance * ca.tan(theta)
    approach = v0 * ca.cos(theta)
    lam = exact_scalar_solution(-approach, 1 / mass + arm**2 / inertia)
    omega = ca.if_else(ca.fabs(arm) <= length, arm * lam / inertia, 0.0)
    return _objective("pivot", theta, -(omega**2), "rad", "angle of the throw")


def _objective(name: str, theta: ca.SX, cost: ca.SX, unit: str, meaning: str) -> StaticObjective:
    decision = (Signal("theta", unit, meaning),)
    return StaticObjective(name, decision, theta, cost, np.zeros(1), ParameterTable())
