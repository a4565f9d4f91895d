"""Scenes of bodies that meet: two balls in line, a push from a start without contact, a pendulum onto a stop."""

from __future__ import annotations

import casadi as ca
import numpy as np

from problems.gradient_scenes.mjcf import RADIUS_M, ball, model
from problems.gradient_scenes.scene import Coordinate, Mechanics, Scene

MASSES_KG, GAP_M = (1.0, 2.0), 0.2
"""Masses of the two balls [kg], and the gap between them at the start [m]."""
BALLS_DURATION_S, PUSH_DURATION_S = 0.6, 0.5
"""Durations of the motion of two balls and of the push [s]."""
FREQUENCY, STOP_ANGLE, SWING_DURATION_S = 2.0, 0.5, 0.8
"""Angular frequency of the pendulum [rad/s], angle of its stop [rad], and duration [s]."""


def balls_outcome(v: ca.SX) -> ca.SX:
    """Return the second ball's final position: ``gap + m1/(m1 + m2) (v T - gap)`` if hit before T, else ``gap``.

    By conservation of momentum both balls have the speed ``m1 v/(m1 + m2)`` after the plastic impact at ``gap/v``.
    """
    return GAP_M + MASSES_KG[0] / sum(MASSES_KG) * ca.fmax(v * BALLS_DURATION_S - GAP_M, 0)


def push_outcome(force: ca.SX) -> ca.SX:
    """Return the final position of the pushed ball, ``gap + (m1 w s + F s^2/2)/(m1 + m2)``.

    The pusher starts at rest and meets the ball at ``t = sqrt(2 gap m1/F)`` with the speed ``w = F t/m1``; the time
    ``s = max(T - t, 0)`` remains. The slope
    follows from ``dt/dF = -t/(2 F)`` and ``dw/dF = w/(2 F)``.
    """
    t = ca.sqrt(2 * GAP_M * MASSES_KG[0] / ca.fmax(force, 1e-9))
    s = ca.fmax(PUSH_DURATION_S - t, 0)
    return GAP_M + (force * t * s + force * s**2 / 2) / sum(MASSES_KG)


def swing_outcome(speed: ca.SX) -> ca.SX:
    """Return the final angle: ``phi cos(W (T - t))`` if the pendulum hits the stop before T, else ``speed/W sin(W T)``.

    The angle is ``speed/W sin(W t)`` until the impact at ``t = asin(phi W/speed)/W``, where the pendulum is at rest:
    the slope is ``phi W sin(W (T - t)) dt/dspeed`` with ``dt/dspeed = -phi/(speed^2 sqrt(1 - (phi W/speed)^2))``.
    """
    ratio = STOP_ANGLE * FREQUENCY / speed
    hits = ca.logic_and(ratio > 0, ratio < 1)
    t = ca.asin(ca.if_else(hits, ratio, 0.5)) / FREQUENCY
    back = STOP_ANGLE * ca.cos(FREQUENCY * (SWING_DURATION_S - t))
    free = speed / FREQUENCY * np.sin(FREQUENCY * SWING_DURATION_S)
    return ca.if_else(ca.logic_and(hits, t < SWING_DURATION_S), back, free)


def _two_balls(is_speed: bool) -> Mechanics:
    """Return the mechanics of two balls on a line; theta is the speed of the first ball or the force on it."""
    coordinates = Coordinate(push=1.0, mass=MASSES_KG[0]), Coordinate(GAP_M, mass=MASSES_KG[1])
    return Mechanics(coordinates, lambda q: q[1] - q[0], is_speed=is_speed)


_TWO_BALLS = model(
    ball("first", MASSES_KG[0], "x", f"{-2 * RADIUS_M} 0 0") + ball("second", MASSES_KG[1], "x", "0 0 0"), gravity=0.0
)
"""MJCF of two balls on a line; the gap is part of the start."""
TWO_BALLS = Scene(
    name="two-balls",
    title="A ball that hits another and moves on with it",
    quantities="v [m/s] speed of the first ball; x2 [m] place of the second ball",
    theta=1.03,
    duration=BALLS_DURATION_S,
    mechanics=_two_balls(is_speed=True),
    outcome=balls_outcome,
    output_index=1,
    mjcf=_TWO_BALLS,
)
PUSH_FROM_AFAR = Scene(
    name="push-from-afar",
    title="A push that ends just before it reaches a ball",
    quantities="F [N] force on the pusher; x2 [m] place of the ball",
    theta=1.5,
    duration=PUSH_DURATION_S,
    mechanics=_two_balls(is_speed=False),
    outcome=push_outcome,
    output_index=1,
    mjcf=_TWO_BALLS,
)
PENDULUM_STOP = Scene(
    name="pendulum-stop",
    title="A torsion pendulum that hits a stop and swings back",
    quantities="w [rad/s] angular speed at the start; angle [rad] angle at the end",
    theta=2.03,
    duration=SWING_DURATION_S,
    mechanics=Mechanics((Coordinate(push=1.0),), lambda q: STOP_ANGLE - q, lambda q: -(FREQUENCY**2) * q),
    outcome=swing_outcome,
    mjcf=model(
        f'<body><joint name="hinge" type="hinge" axis="0 1 0" stiffness="{FREQUENCY**2}" limited="true"'
        f' range="{np.degrees(-3.0)} {np.degrees(STOP_ANGLE)}" solreflimit="0.004 1" solimplimit="0.95 0.99 0.001"/>'
        '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body>',
        gravity=0.0,
    ),
)
