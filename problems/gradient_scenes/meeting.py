"""Scenes of bodies that meet: two balls in line, a push from a start without contact, a pendulum onto a stop."""

from __future__ import annotations

import numpy as np

from dynamics.systems import Signal
from problems.gradient_scenes.mjcf import RADIUS_M, ball, model
from problems.gradient_scenes.scene import Mechanics, Scene

MASSES_KG, GAP_M = (1.0, 2.0), 0.2
"""Masses of the two balls [kg], and the gap between them at the start [m]."""
BALLS_DURATION_S, PUSH_DURATION_S = 0.6, 0.5
"""Durations of the motion of two balls and of the push [s]."""
FREQUENCY, STOP_ANGLE, SWING_DURATION_S = 2.0, 0.5, 0.8
"""Angular frequency of the pendulum [rad/s], angle of its stop [rad], and duration [s]."""


def balls_outcome(v: np.ndarray) -> np.ndarray:
    """Return the path of the second ball, ``m1/(m1 + m2) (v T - gap)`` after the plastic impact at ``gap/v``, or 0.

    Momentum gives both the speed ``m1 v/(m1 + m2)`` from the time gap/v on.
    """
    share = MASSES_KG[0] / sum(MASSES_KG)
    return share * np.maximum(v * BALLS_DURATION_S - GAP_M, 0.0)


def balls_slope(v: np.ndarray) -> np.ndarray:
    """Return ``m1 T/(m1 + m2)`` where the balls meet, else 0."""
    share = MASSES_KG[0] / sum(MASSES_KG)
    return np.where(v * BALLS_DURATION_S > GAP_M, share * BALLS_DURATION_S, 0.0)


def _meeting(force: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the time (n,) left after the pusher meets the ball, 0 if it does not, and its speed (n,) there."""
    acceleration = np.maximum(force, 1e-12) / MASSES_KG[0]
    time = np.sqrt(2 * GAP_M / acceleration)
    return np.maximum(PUSH_DURATION_S - time, 0.0), acceleration * time


def push_outcome(force: np.ndarray) -> np.ndarray:
    """Return the path of the pushed ball, ``(m1 w s + F s^2/2)/(m1 + m2)``, with s = T - t, t and w of the meeting.

    The pusher starts at rest: ``t = sqrt(2 gap m1/F)`` and ``w = F t/m1``. The path is 0 where t > T.
    """
    s, w = _meeting(force)
    return (MASSES_KG[0] * w * s + force * s**2 / 2) / sum(MASSES_KG)


def push_slope(force: np.ndarray) -> np.ndarray:
    """Return the derivative by F, from ``dt/dF = -t/(2 F)`` and ``dw/dF = w/(2 F)``."""
    s, w = _meeting(force)
    t = PUSH_DURATION_S - s
    by_time = (MASSES_KG[0] * w + force * s) * t / (2 * force)
    by_force = MASSES_KG[0] * w * s / (2 * force) + s**2 / 2
    return np.where(s > 0, (by_time + by_force) / sum(MASSES_KG), 0.0)


def swing_outcome(speed: np.ndarray) -> np.ndarray:
    """Return the angle at the end, ``phi cos(W (T - t))`` after the plastic impact, else ``speed/W sin(W T)``.

    The pendulum swings as ``speed/W sin(W t)``, rests at the stop phi at ``t = asin(phi W/speed)/W``, and swings back.
    """
    ratio = STOP_ANGLE * FREQUENCY / speed
    t = np.arcsin(np.clip(ratio, -1, 1)) / FREQUENCY
    back = STOP_ANGLE * np.cos(FREQUENCY * (SWING_DURATION_S - t))
    free = speed / FREQUENCY * np.sin(FREQUENCY * SWING_DURATION_S)
    return np.where((ratio > 0) & (ratio < 1) & (t < SWING_DURATION_S), back, free)


def swing_slope(speed: np.ndarray) -> np.ndarray:
    """Return ``phi W sin(W (T - t)) dt/dspeed`` with ``dt/dspeed = -phi/(speed^2 sqrt(1 - (phi W/speed)^2))``."""
    ratio = np.clip(STOP_ANGLE * FREQUENCY / speed, -1, 1)
    t = np.arcsin(ratio) / FREQUENCY
    hits = (ratio > 0) & (ratio < 1) & (t < SWING_DURATION_S)
    root = np.sqrt(np.where(hits, 1 - ratio**2, 1.0))
    back = -STOP_ANGLE * FREQUENCY * np.sin(FREQUENCY * (SWING_DURATION_S - t)) * STOP_ANGLE / (speed**2 * root)
    return np.where(hits, back, np.sin(FREQUENCY * SWING_DURATION_S) / FREQUENCY)


def _two_balls(is_speed: bool) -> Mechanics:
    return Mechanics(
        masses=MASSES_KG,
        q0=(0.0, GAP_M),
        v0=(0.0, 0.0),
        push=(1.0, 0.0),
        is_speed=is_speed,
        distance=lambda q: q[1] - q[0],
    )


_TWO_BALLS = model(
    ball("first", MASSES_KG[0], "x", f"{-2 * RADIUS_M} 0 0") + ball("second", MASSES_KG[1], "x", "0 0 0"), gravity=0.0
)
"""MJCF of two balls on a line; the gap is part of the start."""

TWO_BALLS = Scene(
    name="two-balls",
    title="A ball that hits another and moves on with it",
    parameter=Signal("v", "m/s", "speed of the first ball"),
    output=Signal("x2", "m", "path of the second ball"),
    theta=1.03,
    duration=BALLS_DURATION_S,
    h=0.01,
    mechanics=_two_balls(is_speed=True),
    outcome=lambda v: GAP_M + balls_outcome(v),
    slope=balls_slope,
    output_index=1,
    mjcf=_TWO_BALLS,
)

PUSH_FROM_AFAR = Scene(
    name="push-from-afar",
    title="A push that ends just before it reaches a ball",
    parameter=Signal("F", "N", "force on the pusher"),
    output=Signal("x2", "m", "place of the ball"),
    theta=1.5,
    duration=PUSH_DURATION_S,
    h=0.01,
    mechanics=_two_balls(is_speed=False),
    outcome=lambda force: GAP_M + push_outcome(force),
    slope=push_slope,
    output_index=1,
    mjcf=_TWO_BALLS,
)

PENDULUM_STOP = Scene(
    name="pendulum-stop",
    title="A torsion pendulum that hits a stop and swings back",
    parameter=Signal("w", "rad/s", "angular speed at the start"),
    output=Signal("angle", "rad", "angle at the end"),
    theta=2.03,
    duration=SWING_DURATION_S,
    h=0.01,
    mechanics=Mechanics(
        masses=(1.0,),
        q0=(0.0,),
        v0=(0.0,),
        push=(1.0,),
        force=lambda q, v: -(FREQUENCY**2) * q,
        distance=lambda q: STOP_ANGLE - q,
    ),
    outcome=swing_outcome,
    slope=swing_slope,
    output_index=0,
    mjcf=model(
        f'<body><joint name="hinge" type="hinge" axis="0 1 0" stiffness="{FREQUENCY**2}" limited="true"'
        f' range="{np.degrees(-3.0)} {np.degrees(STOP_ANGLE)}" solreflimit="0.004 1" solimplimit="0.95 0.99 0.001"/>'
        '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body>',
        gravity=0.0,
    ),
)
