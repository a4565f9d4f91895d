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
"""Gravity of all scenes [m/s^2]."""


class Coordinate(NamedTuple):
    """Coordinate of a scene with its initial value and speed, its mass [kg], and ``push``.

    ``push`` is the initial speed or the force on the coordinate per unit of the parameter.
    """

    start: float = 0.0
    speed: float = 0.0
    push: float = 0.0
    mass: float = 1.0


@dataclass(frozen=True)
class Mechanics:
    """Equations of a scene, from which simulators are built: ``M dv/dt = force(q) + push theta + contact``.

    The force ``push`` times theta acts during the whole motion; if ``is_speed``, it is instead added to the
    initial velocity. ``distance`` maps q to the distance of the contact [m], ``sliding`` to the row of its slip
    velocity, with Coulomb's coefficient ``friction`` (None: without friction). Impacts are plastic, or have the
    coefficient ``restitution`` of Newton.
    """

    coordinates: tuple[Coordinate, ...]
    distance: Pose
    force: Callable[[ca.SX], ca.SX | ca.DM] = lambda q: ca.SX.zeros(q.numel())
    is_speed: bool = True
    sliding: Pose | None = None
    friction: float | None = None
    restitution: float = 0.0

    @cached_property
    def table(self) -> np.ndarray:
        """Array (4, nq) of initial values, speeds, pushes and masses of all coordinates."""
        return np.array(self.coordinates).T


@dataclass(frozen=True)
class Scene:
    """A scene with its rigid limit: the output ``outcome(theta)`` as an expression, differentiated exactly.

    ``quantities`` are names and units of the parameter and the output; ``theta`` is the nominal parameter, and its
    absolute value is the characteristic size; ``output_index`` is the index of the output in the last state (q, v);
    ``duration`` is in seconds. ``mjcf`` is the scene in MuJoCo: its joints are the entries of q, in order.
    """

    name: str
    title: str
    quantities: str
    theta: float
    duration: float
    mechanics: Mechanics
    outcome: Callable[[ca.SX], ca.SX]
    mjcf: str
    output_index: int = 0

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
        """Question on the derivative of the output by the parameter, whose exact output is the rigid limit."""
        parameter, output = signals(self.quantities)
        return Question(np.array([self.theta]), abs(self.theta), self.truth, signals=(parameter, output))
