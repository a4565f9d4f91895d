"""Scenes of dry friction: a box that slides to rest, a box at the threshold of sliding, a block pressed to a wall."""

from __future__ import annotations

import casadi as ca

from problems.gradient_scenes.mjcf import FLOOR, RADIUS_M, ball, model
from problems.gradient_scenes.scene import GRAVITY, Coordinate, Mechanics, Scene

FRICTION, DURATION_S = 0.3, 0.5
"""Coulomb's coefficient of the floor, and the duration of all motions [s]."""
WALL_FRICTION, SPRING = 0.5, 100.0
"""Coulomb's coefficient of the wall, and the stiffness of the spring [N/m]."""


def slide_outcome(v: ca.SX) -> ca.SX:
    """Return the distance slid to rest, ``x = v |v| / (2 f g)``: kinetic energy is the work of friction."""
    return v * ca.fabs(v) / (2 * FRICTION * GRAVITY)


def threshold_outcome(force: ca.SX) -> ca.SX:
    """Return the distance slid in the time T from rest, ``max(F/m - f g, 0) T^2/2`` for F > 0 and m = 1 kg."""
    return ca.fmax(force - FRICTION * GRAVITY, 0) * DURATION_S**2 / 2


def wall_outcome(compression: ca.SX) -> ca.SX:
    """Return the displacement ``z = -max(g - f k d/m, 0) T^2/2`` of a block pressed to the wall with the force k d."""
    return -ca.fmax(GRAVITY - WALL_FRICTION * SPRING * compression, 0) * DURATION_S**2 / 2


def _on_floor(is_speed: bool) -> Mechanics:
    """Return the mechanics of a box of 1 kg on a rough floor; theta is its initial speed or the force on it."""
    return Mechanics(
        (Coordinate(push=1.0), Coordinate()),
        is_speed=is_speed,
        force=lambda q: ca.DM([0.0, -GRAVITY]),
        distance=lambda q: q[1],
        sliding=lambda q: ca.SX([[1.0, 0.0]]),
        friction=FRICTION,
    )


_BOX = model(ball("box", 1.0, "x z") + FLOOR, friction=FRICTION)
"""MJCF of a box on the floor; it may also lift, so that the normal force is MuJoCo's."""
SLIDE_TO_REST = Scene(
    name="slide-to-rest",
    title="A box that slides to rest on a rough floor",
    quantities="v [m/s] speed at the start; x [m] place of rest",
    theta=1.03,
    duration=DURATION_S,
    mechanics=_on_floor(is_speed=True),
    outcome=slide_outcome,
    mjcf=_BOX,
)
STICK_SLIP = Scene(
    name="stick-slip",
    title="A box that is pushed just enough to slide",
    quantities="F [N] force; x [m] distance slid",
    theta=3.0,
    duration=DURATION_S,
    mechanics=_on_floor(is_speed=False),
    outcome=threshold_outcome,
    mjcf=_BOX,
)
WALL_SPRING = Scene(
    name="wall-spring",
    title="A block that a spring presses to a rough wall, and that slides down",
    quantities="d [m] compression of the spring; z [m] height at the end",
    theta=0.1,
    duration=DURATION_S,
    mechanics=Mechanics(
        (Coordinate(push=-SPRING), Coordinate()),
        is_speed=False,
        force=lambda q: ca.vertcat(-SPRING * q[0], -GRAVITY),
        distance=lambda q: q[0],
        sliding=lambda q: ca.SX([[0.0, 1.0]]),
        friction=WALL_FRICTION,
    ),
    outcome=wall_outcome,
    output_index=1,
    mjcf=model(
        ball("block", 1.0, "x z", f"{RADIUS_M} 0 0").replace('axis="1 0 0"', f'axis="1 0 0" stiffness="{SPRING}"')
        + FLOOR.replace("/>", ' zaxis="1 0 0"/>'),
        friction=WALL_FRICTION,
    ),
)
