"""Scenes: small mechanisms in contact with one parameter, one output, and their rigid limit in closed form."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import casadi as ca
import numpy as np

from dynamics.batch import BatchFunction
from dynamics.systems import signals
from ocp.gradients.worlds.report import Question
from ocp.gradients.worlds.world import World

Pose = Callable[[ca.SX], ca.SX]
"""Function from q (nq, 1) to distances or rows of a Jacobian."""
GRAVITY = 9.81
"""Gravity of all scenes but the flight past a corner [m/s^2]."""


class Coordinate(NamedTuple):
    """Coordinate of a scene along an axis, x or z, or the angle of a hinge, ``y``.

    It has an initial value and speed, a mass [kg], and a spring [N/m] to zero. ``push`` is the initial speed or the
    force on the coordinate per unit of the parameter.
    """

    axis: str
    start: float = 0.0
    speed: float = 0.0
    push: float = 0.0
    mass: float = 1.0
    spring: float = 0.0


@dataclass(frozen=True)
class Mechanics:
    """Equations of a scene: ``M dv/dt = -spring q - M gravity + push theta + contact``, with gravity along -z.

    The force ``push`` times theta acts during the whole motion; if ``is_speed``, it is instead added to the
    initial velocity. ``distance`` maps q to the distance of the contact [m], by default the last coordinate: the
    height above a plane, on which the first coordinate slides with Coulomb's coefficient ``friction`` (None: without
    friction). Impacts are plastic, or have the coefficient ``restitution`` of Newton.
    """

    coordinates: tuple[Coordinate, ...]
    distance: Pose = lambda q: q[-1]
    is_speed: bool = True
    friction: float | None = None
    restitution: float = 0.0
    gravity: float = GRAVITY

    @cached_property
    def table(self) -> np.ndarray:
        """Array (5, nq) of initial values, speeds, pushes, masses and springs of all coordinates."""
        return np.array([coordinate[1:] for coordinate in self.coordinates]).T

    def force(self, q: ca.SX) -> ca.SX:
        """Return the force (nq, 1) of springs and gravity at q (nq, 1)."""
        weights = [self.gravity * each.mass * (each.axis == "z") for each in self.coordinates]
        return -ca.DM(self.table[4]) * q - ca.DM(weights)

    @property
    def damping_ratio(self) -> float:
        """Damping ratio zeta of a spring with the restitution ``exp(-pi zeta / sqrt(1 - zeta^2))``; 1 if plastic."""
        log = np.log(self.restitution or 1.0)
        return float(-log / np.hypot(np.pi, log)) if self.restitution > 0 else 1.0

    @property
    def sliding(self) -> Pose | None:
        """Function from q to the row (1, nq) of the slip velocity, or None without friction."""
        row = np.eye(1, len(self.coordinates))
        return None if self.friction is None else lambda q: ca.SX(row)


@dataclass(frozen=True)
class Scene:
    """A scene with its rigid limit: the output ``outcome(theta)`` as an expression, differentiated exactly.

    ``quantities`` are names and units of the parameter and the output; ``theta`` is the nominal parameter, and its
    absolute value is the characteristic size; ``output_index`` is the index of the output in the last state (q, v);
    ``duration`` is in seconds. ``bodies`` is the MJCF of bodies and obstacles whose joints are the entries of q, in
    order; by default it is a ball above a plane.
    """

    name: str
    title: str
    quantities: str
    theta: float
    duration: float
    mechanics: Mechanics
    outcome: Callable[[ca.SX], ca.SX]
    output_index: int = 0
    bodies: str = ""

    @cached_property
    def truth(self) -> World:
        """Rigid limit as a simulator, with its exact gradient."""
        theta = ca.SX.sym("theta")
        outcome = ca.densify(ca.SX(self.outcome(theta)))
        values, slopes = (
            BatchFunction(ca.Function("rigid_limit", [theta], [expression]), backend="casadi")
            for expression in (outcome, ca.densify(ca.jacobian(outcome, theta)))
        )
        return World("closed-form", values, lambda rows: slopes(rows)[:, :, None], method="formula")

    @property
    def question(self) -> Question:
        """Derivative of the output by the parameter, to be judged against the derivative of the rigid limit."""
        parameter, output = signals(self.quantities)
        return Question(np.array([self.theta]), abs(self.theta), self.truth, signals=(parameter, output))
