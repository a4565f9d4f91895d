"""Nine scenes: balls that fall, fly or meet, a pendulum onto a stop, and dry friction, each with its closed form.

A ball that starts at the height z with the vertical speed v falls for ``t = (v + w)/g`` and lands at the speed
``w = sqrt(v^2 + 2 g z)``.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from problems.gradient_scenes.mjcf import RADIUS_M, ball
from problems.gradient_scenes.scene import GRAVITY, Coordinate, Mechanics, Scene

HEIGHT_M = 0.5
"""Height from which balls drop [m]."""
DROP_SPEED, DROP_FRICTION = 1.0, 0.2
"""Horizontal speed [m/s] and Coulomb's coefficient of the oblique drop."""
RESTITUTION, BOUNCE_DURATION_S = 0.7, 0.4
"""Coefficient of restitution, and duration of the bounce [s]."""
WALL_X_M, WALL_TOP_M, FLIGHT_SPEED, FLIGHT_DURATION_S = 0.5, 0.25, 1.0, 1.0
"""Distance [m] and height [m] of the corner, horizontal speed [m/s] and duration [s] of the flight past it."""
MASSES_KG, GAP_M = (1.0, 2.0), 0.2
"""Masses of the two balls [kg], and the gap between them at the start [m]."""
BALLS_DURATION_S, PUSH_DURATION_S = 0.6, 0.5
"""Durations of the motion of two balls and of the push [s]."""
FREQUENCY, STOP_ANGLE, SWING_DURATION_S = 2.0, 0.5, 0.8
"""Angular frequency of the pendulum [rad/s], angle of its stop [rad], and duration [s]."""
FRICTION, SLIDE_DURATION_S = 0.3, 0.5
"""Coulomb's coefficient of the floor, and the duration of sliding motions [s]."""
WALL_FRICTION, SPRING = 0.5, 100.0
"""Coulomb's coefficient of the wall, and the stiffness of the spring [N/m]."""


def _landing(v: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return the time [s] and the vertical speed [m/s] of landing."""
    w = ca.sqrt(v**2 + 2 * GRAVITY * HEIGHT_M)
    return (v + w) / GRAVITY, w


def drop_outcome(v: ca.SX) -> ca.SX:
    """Return the position at which the ball comes to rest, ``x = u t + (u - f w)^2 / (2 f g)``.

    The plastic impact reduces the horizontal speed u by f w, and the ball then slides to rest under friction f.
    """
    t, w = _landing(v)
    return DROP_SPEED * t + ca.fmax(DROP_SPEED - DROP_FRICTION * w, 0) ** 2 / (2 * DROP_FRICTION * GRAVITY)


def bounce_outcome(v: ca.SX) -> ca.SX:
    """Return the final height ``e w s - g s^2/2`` with ``s = T - t``, in flight after the first impact at t."""
    t, w = _landing(v)
    s = BOUNCE_DURATION_S - t
    return RESTITUTION * w * s - GRAVITY * s**2 / 2


def slide_outcome(v: ca.SX) -> ca.SX:
    """Return the distance slid to rest, ``x = v |v| / (2 f g)``: kinetic energy is the work of friction."""
    return v * ca.fabs(v) / (2 * FRICTION * GRAVITY)


def threshold_outcome(force: ca.SX) -> ca.SX:
    """Return the distance slid in the time T from rest, ``max(F/m - f g, 0) T^2/2`` for F > 0 and m = 1 kg."""
    return ca.fmax(force - FRICTION * GRAVITY, 0) * SLIDE_DURATION_S**2 / 2


def wall_outcome(compression: ca.SX) -> ca.SX:
    """Return the displacement ``z = -max(g - f k d/m, 0) T^2/2`` of a block pressed to the wall with the force k d."""
    return -ca.fmax(GRAVITY - WALL_FRICTION * SPRING * compression, 0) * SLIDE_DURATION_S**2 / 2


def balls_outcome(v: ca.SX) -> ca.SX:
    """Return the second ball's final position: ``gap + m1/(m1 + m2) (v T - gap)`` if hit before T, else ``gap``.

    By conservation of momentum both balls have the speed ``m1 v/(m1 + m2)`` after the plastic impact at ``gap/v``.
    """
    return GAP_M + MASSES_KG[0] / sum(MASSES_KG) * ca.fmax(v * BALLS_DURATION_S - GAP_M, 0)


def push_outcome(force: ca.SX) -> ca.SX:
    """Return the final position of the pushed ball, ``gap + (m1 w s + F s^2/2)/(m1 + m2)``.

    The pusher starts at rest and meets the ball at ``t = sqrt(2 gap m1/F)`` with the speed ``w = F t/m1``; the time
    ``s = max(T - t, 0)`` remains.
    """
    t = ca.sqrt(2 * GAP_M * MASSES_KG[0] / ca.fmax(force, 1e-9))
    s = ca.fmax(PUSH_DURATION_S - t, 0)
    return GAP_M + (force * t * s + force * s**2 / 2) / sum(MASSES_KG)


def swing_outcome(speed: ca.SX) -> ca.SX:
    """Return the final angle: ``phi cos(W (T - t))`` if the pendulum hits the stop before T, else ``speed/W sin(W T)``.

    The angle is ``speed/W sin(W t)`` until the impact at ``t = asin(phi W/speed)/W``, where the pendulum is at rest.
    """
    ratio = STOP_ANGLE * FREQUENCY / speed
    hits = ca.logic_and(ratio > 0, ratio < 1)
    t = ca.asin(ca.if_else(hits, ratio, 0.5)) / FREQUENCY
    back = STOP_ANGLE * ca.cos(FREQUENCY * (SWING_DURATION_S - t))
    free = speed / FREQUENCY * np.sin(FREQUENCY * SWING_DURATION_S)
    return ca.if_else(ca.logic_and(hits, t < SWING_DURATION_S), back, free)


def corner_outcome(v: ca.SX) -> ca.SX:
    """Return the final position without gravity: u T, or X if the ball hits the wall at X, ``v X/u`` below its top."""
    passes = v * WALL_X_M / FLIGHT_SPEED >= WALL_TOP_M
    return ca.if_else(passes, FLIGHT_SPEED * FLIGHT_DURATION_S, WALL_X_M)


_DROP = Coordinate("z", HEIGHT_M, push=1.0)
"""Height of a ball that drops."""
_BOX = (Coordinate("x", push=1.0), Coordinate("z"))
"""Coordinates of a box on the floor; it may also lift, so that the normal force is MuJoCo's."""
_BALLS = (Coordinate("x", push=1.0, mass=MASSES_KG[0]), Coordinate("x", GAP_M, mass=MASSES_KG[1]))
"""Coordinates of two balls on a line."""
_BALL_BODIES = ball("first", _BALLS[:1], f"{-2 * RADIUS_M} 0 0") + ball("second", _BALLS[1:], "0 0 0")
"""MJCF of two balls on a line; the gap is part of the start."""
_FLIGHT = (Coordinate("x", speed=FLIGHT_SPEED), Coordinate("z", push=1.0))
"""Coordinates of a ball that flies past a corner."""
_ROWS = (
    Scene(
        "oblique-drop",
        "A ball that drops obliquely on a rough floor, and slides to rest",
        "v [m/s] vertical speed at the start; x [m] place of rest",
        -1.03,
        0.6,
        Mechanics((Coordinate("x", speed=DROP_SPEED), _DROP), friction=DROP_FRICTION),
        drop_outcome,
    ),
    Scene(
        "bounce",
        "A ball that drops on a floor and bounces",
        "v [m/s] vertical speed at the start; z [m] height at the end",
        -1.03,
        BOUNCE_DURATION_S,
        Mechanics((_DROP,), restitution=RESTITUTION),
        bounce_outcome,
    ),
    Scene(
        "slide-to-rest",
        "A box that slides to rest on a rough floor",
        "v [m/s] speed at the start; x [m] place of rest",
        1.03,
        SLIDE_DURATION_S,
        Mechanics(_BOX, friction=FRICTION),
        slide_outcome,
    ),
    Scene(
        "wall-spring",
        "A block that a spring presses to a rough wall, and that slides down",
        "d [m] compression of the spring; z [m] height at the end",
        0.1,
        SLIDE_DURATION_S,
        Mechanics(
            (Coordinate("z"), Coordinate("x", push=-SPRING, spring=SPRING)), is_speed=False, friction=WALL_FRICTION
        ),
        wall_outcome,
    ),
    Scene(
        "two-balls",
        "A ball that hits another and moves on with it",
        "v [m/s] speed of the first ball; x2 [m] place of the second ball",
        1.03,
        BALLS_DURATION_S,
        Mechanics(_BALLS, lambda q: q[1] - q[0]),
        balls_outcome,
        1,
        _BALL_BODIES,
    ),
    Scene(
        "pendulum-stop",
        "A torsion pendulum that hits a stop and swings back",
        "w [rad/s] angular speed at the start; angle [rad] angle at the end",
        2.03,
        SWING_DURATION_S,
        Mechanics((Coordinate("y", push=1.0, spring=FREQUENCY**2),), lambda q: STOP_ANGLE - q),
        swing_outcome,
        bodies=f'<body><joint name="hinge" type="hinge" axis="0 1 0" stiffness="{FREQUENCY**2}" limited="true"'
        f' range="{np.degrees(-3.0)} {np.degrees(STOP_ANGLE)}" solreflimit="0.004 1" solimplimit="0.95 0.99 0.001"/>'
        '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body>',
    ),
    Scene(
        "corner",
        "A ball that flies past the corner of a wall, or stops at it",
        "v [m/s] vertical speed at the start; x [m] place at the end",
        0.51,
        FLIGHT_DURATION_S,
        Mechanics(_FLIGHT, lambda q: ca.fmax(WALL_X_M - q[0], q[1] - WALL_TOP_M), gravity=0.0),
        corner_outcome,
        bodies=ball("ball", _FLIGHT, f"0 0 {RADIUS_M}")
        + f'<geom name="wall" type="box" size="2 1 2" pos="{WALL_X_M + 2.001} 0 {WALL_TOP_M - 2.001}"/>',
    ),
    Scene(
        "push-from-afar",
        "A push that ends just before it reaches a ball",
        "F [N] force on the pusher; x2 [m] place of the ball",
        1.5,
        PUSH_DURATION_S,
        Mechanics(_BALLS, lambda q: q[1] - q[0], is_speed=False),
        push_outcome,
        1,
        _BALL_BODIES,
    ),
    Scene(
        "stick-slip",
        "A box that is pushed just enough to slide",
        "F [N] force; x [m] distance slid",
        3.0,
        SLIDE_DURATION_S,
        Mechanics(_BOX, is_speed=False, friction=FRICTION),
        threshold_outcome,
    ),
)
SCENES: dict[str, Scene] = {scene.name: scene for scene in _ROWS}
"""Mapping from the name of a scene to the scene."""
