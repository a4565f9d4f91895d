"""Scenes of a falling or flying ball: an oblique drop with friction, a drop with restitution, a flight past a corner.

A ball that starts at the height z with the vertical speed v falls for ``t = (v + w)/g`` and lands at the speed
``w = sqrt(v^2 + 2 g z)``. The derivatives by v are ``dw/dv = v/w`` and ``dt/dv = (1 + v/w)/g = t/w``.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from dynamics.systems import Signal
from problems.gradient_scenes.mjcf import ball, model
from problems.gradient_scenes.scene import GRAVITY, Mechanics, Scene

DROP_HEIGHT_M, DROP_SPEED, DROP_FRICTION = 0.5, 1.0, 0.2
"""Height [m], horizontal speed [m/s] and Coulomb's coefficient of the oblique drop."""
BOUNCE_HEIGHT_M, RESTITUTION, BOUNCE_DURATION_S = 0.5, 0.7, 0.4
"""Height [m], coefficient of restitution and duration [s] of the drop with restitution."""
WALL_X_M, WALL_TOP_M, FLIGHT_SPEED, FLIGHT_DURATION_S = 0.5, 0.25, 1.0, 1.0
"""Distance [m] and height [m] of the corner, horizontal speed [m/s] and duration [s] of the flight past it."""


def _landing(v: np.ndarray, height: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the time (n,) [s] and the vertical speed (n,) [m/s] of landing."""
    w = np.sqrt(v**2 + 2 * GRAVITY * height)
    return (v + w) / GRAVITY, w


def drop_outcome(v: np.ndarray) -> np.ndarray:
    """Return where the ball comes to rest, ``x = u t + (u - f w)^2 / (2 f g)``.

    The plastic impact takes f w off the horizontal speed u, and friction f stops the rest of it.
    """
    t, w = _landing(v, DROP_HEIGHT_M)
    rest = np.maximum(DROP_SPEED - DROP_FRICTION * w, 0.0)
    return DROP_SPEED * t + rest**2 / (2 * DROP_FRICTION * GRAVITY)


def drop_slope(v: np.ndarray) -> np.ndarray:
    """Return ``dx/dv = (u t - (u - f w) v/g) / w``, from ``dt/dv = t/w`` and ``dw/dv = v/w``."""
    t, w = _landing(v, DROP_HEIGHT_M)
    rest = np.maximum(DROP_SPEED - DROP_FRICTION * w, 0.0)
    return (DROP_SPEED * t - rest * v / GRAVITY) / w


def bounce_outcome(v: np.ndarray) -> np.ndarray:
    """Return the height at the end, ``e w s - g s^2/2`` with ``s = T - t``, in the air after the first impact."""
    t, w = _landing(v, BOUNCE_HEIGHT_M)
    s = BOUNCE_DURATION_S - t
    return RESTITUTION * w * s - GRAVITY * s**2 / 2


def bounce_slope(v: np.ndarray) -> np.ndarray:
    """Return ``e s v/w - (e w - g s) t/w``, from ``ds/dv = -t/w`` and ``dw/dv = v/w``."""
    t, w = _landing(v, BOUNCE_HEIGHT_M)
    s = BOUNCE_DURATION_S - t
    return (RESTITUTION * s * v - (RESTITUTION * w - GRAVITY * s) * t) / w


def corner_outcome(v: np.ndarray) -> np.ndarray:
    """Return where the ball ends without gravity: u T above the corner, at the wall X if ``v X/u`` is below its top."""
    passes = v * WALL_X_M / FLIGHT_SPEED >= WALL_TOP_M
    return np.where(passes, FLIGHT_SPEED * FLIGHT_DURATION_S, WALL_X_M)


def _corner_distance(q: ca.SX) -> ca.SX:
    """Return the distance from the quarter plane ``x > X, z < top``, exact in front of the wall and above it."""
    return ca.fmax(WALL_X_M - q[0], q[1] - WALL_TOP_M)


OBLIQUE_DROP = Scene(
    name="oblique-drop",
    title="A ball that drops obliquely on a rough floor, and slides to rest",
    parameter=Signal("v", "m/s", "vertical speed at the start"),
    output=Signal("x", "m", "place of rest"),
    theta=-1.03,
    duration=0.6,
    h=0.01,
    mechanics=Mechanics(
        masses=(1.0, 1.0),
        q0=(0.0, DROP_HEIGHT_M),
        v0=(DROP_SPEED, 0.0),
        push=(0.0, 1.0),
        force=lambda q, v: ca.vertcat(0.0, -GRAVITY),
        distance=lambda q: q[1],
        sliding=lambda q: ca.SX([[1.0, 0.0]]),
        friction=DROP_FRICTION,
    ),
    outcome=drop_outcome,
    slope=drop_slope,
    output_index=0,
    mjcf=model(ball("ball", 1.0, "x z") + '<geom name="floor" type="plane" size="0 0 1"/>', friction=DROP_FRICTION),
)

BOUNCE = Scene(
    name="bounce",
    title="A ball that drops on a floor and bounces",
    parameter=Signal("v", "m/s", "vertical speed at the start"),
    output=Signal("z", "m", "height at the end"),
    theta=-1.03,
    duration=BOUNCE_DURATION_S,
    h=0.01,
    mechanics=Mechanics(
        masses=(1.0,),
        q0=(BOUNCE_HEIGHT_M,),
        v0=(0.0,),
        push=(1.0,),
        force=lambda q, v: ca.SX([-GRAVITY]),
        distance=lambda q: q[0],
        restitution=RESTITUTION,
    ),
    outcome=bounce_outcome,
    slope=bounce_slope,
    output_index=0,
    mjcf=model(ball("ball", 1.0, "z") + '<geom name="floor" type="plane" size="0 0 1"/>', restitution=RESTITUTION),
)

CORNER = Scene(
    name="corner",
    title="A ball that flies past the corner of a wall, or stops at it",
    parameter=Signal("v", "m/s", "vertical speed at the start"),
    output=Signal("x", "m", "place at the end"),
    theta=0.51,
    duration=FLIGHT_DURATION_S,
    h=0.01,
    mechanics=Mechanics(
        masses=(1.0, 1.0),
        q0=(0.0, 0.0),
        v0=(FLIGHT_SPEED, 0.0),
        push=(0.0, 1.0),
        distance=_corner_distance,
    ),
    outcome=corner_outcome,
    slope=np.zeros_like,
    output_index=0,
    mjcf=model(
        ball("ball", 1.0, "x z")
        + f'<geom name="wall" type="box" size="2 1 2" pos="{WALL_X_M + 2.001} 0 {WALL_TOP_M - 2.001}"/>',
        gravity=0.0,
    ),
)
