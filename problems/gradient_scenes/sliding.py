"""Scenes of dry friction: a box that slides to rest, a box at the threshold of sliding, a block pressed to a wall."""

from __future__ import annotations

import casadi as ca
import numpy as np

from dynamics.systems import Signal
from problems.gradient_scenes.mjcf import RADIUS_M, ball, model
from problems.gradient_scenes.scene import GRAVITY, Mechanics, Scene

FRICTION, FLOOR_DURATION_S = 0.3, 0.5
"""Coulomb's coefficient of the floor, and the duration of the motions on it [s]."""
WALL_FRICTION, SPRING, WALL_DURATION_S = 0.5, 100.0, 0.5
"""Coulomb's coefficient of the wall, stiffness of the spring [N/m] and duration [s]."""


def slide_outcome(v: np.ndarray) -> np.ndarray:
    """Return the distance slid to rest, ``x = v |v| / (2 f g)``: kinetic energy is the work of friction."""
    return v * np.abs(v) / (2 * FRICTION * GRAVITY)


def slide_slope(v: np.ndarray) -> np.ndarray:
    """Return ``dx/dv = |v| / (f g)``."""
    return np.abs(v) / (FRICTION * GRAVITY)


def threshold_outcome(force: np.ndarray) -> np.ndarray:
    """Return the distance slid in the time T from rest, ``max(F/m - f g, 0) T^2/2`` for F > 0 and m = 1 kg."""
    return np.maximum(force - FRICTION * GRAVITY, 0.0) * FLOOR_DURATION_S**2 / 2


def threshold_slope(force: np.ndarray) -> np.ndarray:
    """Return T^2/2 in motion, and 0 below the threshold f m g."""
    return np.where(force > FRICTION * GRAVITY, FLOOR_DURATION_S**2 / 2, 0.0)


def wall_outcome(compression: np.ndarray) -> np.ndarray:
    """Return how far the block moves, ``z = -max(g - f k d/m, 0) T^2/2``: the spring presses it with k d."""
    return -np.maximum(GRAVITY - WALL_FRICTION * SPRING * compression, 0.0) * WALL_DURATION_S**2 / 2


def wall_slope(compression: np.ndarray) -> np.ndarray:
    """Return ``dz/dd = f k T^2 / (2 m)`` while it slides, and 0 where friction holds it."""
    slides = WALL_FRICTION * SPRING * compression < GRAVITY
    return np.where(slides, WALL_FRICTION * SPRING * WALL_DURATION_S**2 / 2, 0.0)


_FLOOR = model(ball("box", 1.0, "x z") + '<geom name="floor" type="plane" size="0 0 1"/>', friction=FRICTION)
"""MJCF of a box on the floor; it may also lift, so that the normal force is MuJoCo's."""


def _on_floor(push: float, is_speed: bool) -> Mechanics:
    """Return a box of 1 kg on a rough floor, which theta sets in motion at the start or pushes."""
    return Mechanics(
        masses=(1.0, 1.0),
        q0=(0.0, 0.0),
        v0=(0.0, 0.0),
        push=(push, 0.0),
        is_speed=is_speed,
        force=lambda q, v: ca.vertcat(0.0, -GRAVITY),
        distance=lambda q: q[1],
        sliding=lambda q: ca.SX([[1.0, 0.0]]),
        friction=FRICTION,
    )


SLIDE_TO_REST = Scene(
    name="slide-to-rest",
    title="A box that slides to rest on a rough floor",
    parameter=Signal("v", "m/s", "speed at the start"),
    output=Signal("x", "m", "place of rest"),
    theta=1.03,
    duration=FLOOR_DURATION_S,
    h=0.01,
    mechanics=_on_floor(1.0, is_speed=True),
    outcome=slide_outcome,
    slope=slide_slope,
    output_index=0,
    mjcf=_FLOOR,
)

STICK_SLIP = Scene(
    name="stick-slip",
    title="A box that is pushed just enough to slide",
    parameter=Signal("F", "N", "force"),
    output=Signal("x", "m", "distance slid"),
    theta=3.0,
    duration=FLOOR_DURATION_S,
    h=0.01,
    mechanics=_on_floor(1.0, is_speed=False),
    outcome=threshold_outcome,
    slope=threshold_slope,
    output_index=0,
    mjcf=_FLOOR,
)

WALL_SPRING = Scene(
    name="wall-spring",
    title="A block that a spring presses to a rough wall, and that slides down",
    parameter=Signal("d", "m", "compression of the spring"),
    output=Signal("z", "m", "height at the end"),
    theta=0.1,
    duration=WALL_DURATION_S,
    h=0.01,
    mechanics=Mechanics(
        masses=(1.0, 1.0),
        q0=(0.0, 0.0),
        v0=(0.0, 0.0),
        push=(-SPRING, 0.0),
        is_speed=False,
        force=lambda q, v: ca.vertcat(-SPRING * q[0], -GRAVITY),
        distance=lambda q: q[0],
        sliding=lambda q: ca.SX([[0.0, 1.0]]),
        friction=WALL_FRICTION,
    ),
    outcome=wall_outcome,
    slope=wall_slope,
    output_index=1,
    mjcf=model(
        ball("block", 1.0, "x z", f"{RADIUS_M} 0 0").replace('axis="1 0 0"', f'axis="1 0 0" stiffness="{SPRING}"')
        + '<geom name="wall" type="plane" size="0 0 1" zaxis="1 0 0"/>',
        friction=WALL_FRICTION,
    ),
)
