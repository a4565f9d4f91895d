"""Scenes of a falling or flying ball: an oblique drop with friction, a drop with restitution, a flight past a corner.

A ball that starts at the height z with the vertical speed v falls for ``t = (v + w)/g`` and lands at the speed
``w = sqrt(v^2 + 2 g z)``.
"""

from __future__ import annotations

import casadi as ca

from problems.gradient_scenes.mjcf import FLOOR, ball, model
from problems.gradient_scenes.scene import GRAVITY, Coordinate, Mechanics, Scene

HEIGHT_M = 0.5
"""Height from which balls drop [m]."""
DROP_SPEED, DROP_FRICTION = 1.0, 0.2
"""Horizontal speed [m/s] and Coulomb's coefficient of the oblique drop."""
RESTITUTION, BOUNCE_DURATION_S = 0.7, 0.4
"""Coefficient of restitution, and duration of the bounce [s]."""
WALL_X_M, WALL_TOP_M, FLIGHT_SPEED, FLIGHT_DURATION_S = 0.5, 0.25, 1.0, 1.0
"""Distance [m] and height [m] of the corner, horizontal speed [m/s] and duration [s] of the flight past it."""


def _landing(v: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return the time [s] and the vertical speed [m/s] of landing."""
    w = ca.sqrt(v**2 + 2 * GRAVITY * HEIGHT_M)
    return (v + w) / GRAVITY, w


def drop_outcome(v: ca.SX) -> ca.SX:
    """Return the position at which the ball comes to rest, ``x = u t + (u - f w)^2 / (2 f g)``.

    The plastic impact reduces the horizontal speed u by f w, and the ball then slides to rest under friction f.
    With ``dt/dv = t/w`` and ``dw/dv = v/w`` the slope is ``(u t - (u - f w) v/g) / w``.
    """
    t, w = _landing(v)
    return DROP_SPEED * t + ca.fmax(DROP_SPEED - DROP_FRICTION * w, 0) ** 2 / (2 * DROP_FRICTION * GRAVITY)


def bounce_outcome(v: ca.SX) -> ca.SX:
    """Return the final height ``e w s - g s^2/2`` with ``s = T - t``, in flight after the first impact at t.

    The slope is ``(e s v - (e w - g s) t) / w``.
    """
    t, w = _landing(v)
    s = BOUNCE_DURATION_S - t
    return RESTITUTION * w * s - GRAVITY * s**2 / 2


def corner_outcome(v: ca.SX) -> ca.SX:
    """Return the final position without gravity: u T, or X if the ball hits the wall at X, ``v X/u`` below its top."""
    passes = v * WALL_X_M / FLIGHT_SPEED >= WALL_TOP_M
    return ca.if_else(passes, FLIGHT_SPEED * FLIGHT_DURATION_S, WALL_X_M)


OBLIQUE_DROP = Scene(
    name="oblique-drop",
    title="A ball that drops obliquely on a rough floor, and slides to rest",
    quantities="v [m/s] vertical speed at the start; x [m] place of rest",
    theta=-1.03,
    duration=0.6,
    mechanics=Mechanics(
        (Coordinate(speed=DROP_SPEED), Coordinate(HEIGHT_M, push=1.0)),
        force=lambda q: ca.DM([0.0, -GRAVITY]),
        distance=lambda q: q[1],
        sliding=lambda q: ca.SX([[1.0, 0.0]]),
        friction=DROP_FRICTION,
    ),
    outcome=drop_outcome,
    mjcf=model(ball("ball", 1.0, "x z") + FLOOR, friction=DROP_FRICTION),
)
BOUNCE = Scene(
    name="bounce",
    title="A ball that drops on a floor and bounces",
    quantities="v [m/s] vertical speed at the start; z [m] height at the end",
    theta=-1.03,
    duration=BOUNCE_DURATION_S,
    mechanics=Mechanics(
        (Coordinate(HEIGHT_M, push=1.0),),
        force=lambda q: ca.DM([-GRAVITY]),
        distance=lambda q: q[0],
        restitution=RESTITUTION,
    ),
    outcome=bounce_outcome,
    mjcf=model(ball("ball", 1.0, "z") + FLOOR, restitution=RESTITUTION),
)
CORNER = Scene(
    name="corner",
    title="A ball that flies past the corner of a wall, or stops at it",
    quantities="v [m/s] vertical speed at the start; x [m] place at the end",
    theta=0.51,
    duration=FLIGHT_DURATION_S,
    mechanics=Mechanics(
        (Coordinate(speed=FLIGHT_SPEED), Coordinate(push=1.0)),
        distance=lambda q: ca.fmax(WALL_X_M - q[0], q[1] - WALL_TOP_M),
    ),
    outcome=corner_outcome,
    mjcf=model(
        ball("ball", 1.0, "x z")
        + f'<geom name="wall" type="box" size="2 1 2" pos="{WALL_X_M + 2.001} 0 {WALL_TOP_M - 2.001}"/>',
        gravity=0.0,
    ),
)
