"""A scene: a small mechanism in contact with one parameter, one output, and its rigid limit in closed form."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import casadi as ca
import numpy as np

from dynamics.systems import Signal
from ocp.gradients.worlds.report import Question
from ocp.gradients.worlds.world import World

Force = Callable[[ca.SX, ca.SX], ca.SX | ca.DM]
"""Function from (q, v) to forces (nq, 1) [N]."""
Pose = Callable[[ca.SX], ca.SX]
"""Function from q (nq, 1) to distances or rows of a Jacobian."""
GRAVITY = 9.81
"""Gravity of all scenes [m/s^2]."""


@dataclass(frozen=True)
class Mechanics:
    """Equations of a scene, from which worlds are built: ``M dv/dt = force(q, v) + push theta + contact``.

    ``masses`` (nq,) is the diagonal of M [kg], ``q0`` and ``v0`` (nq,) are the start. The parameter theta acts as
    the force ``push`` (nq,) times theta during the whole motion, or, if ``is_speed``, as the velocity ``push`` times
    theta that is added to v0. ``distance`` maps q to the distance of each contact [m], ``sliding`` to the rows of
    slip velocities, with Coulomb's coefficient ``friction`` (None: without friction). Impacts are plastic, or have the
    coefficient ``restitution`` of Newton.
    """

    masses: tuple[float, ...]
    q0: tuple[float, ...]
    v0: tuple[float, ...]
    push: tuple[float, ...]
    distance: Pose
    force: Force = lambda q, v: ca.SX.zeros(q.numel())
    is_speed: bool = True
    sliding: Pose | None = None
    friction: float | None = None
    restitution: float = 0.0


@dataclass(frozen=True)
class Scene:
    """A scene with its rigid limit: the output ``outcome(theta)`` and its derivative ``slope(theta)``, both (n,).

    ``parameter`` and ``output`` are names and units; ``theta`` is the nominal parameter, which is also its size;
    ``output_of`` maps the last state (q, v) to the output; ``duration`` is in seconds, and ``h`` the step of time
    stepping. ``mjcf`` is the scene in MuJoCo: its joints are the entries of q, in order.
    """

    name: str
    title: str
    parameter: Signal
    output: Signal
    theta: float
    duration: float
    h: float
    mechanics: Mechanics
    outcome: Callable[[np.ndarray], np.ndarray]
    slope: Callable[[np.ndarray], np.ndarray]
    output_index: int
    mjcf: str

    @property
    def truth(self) -> World:
        """The rigid limit as a world."""
        return World(
            "closed-form",
            partial(_outputs, self.outcome),
            partial(_gradients, self.slope),
            method="derivative of the closed form",
        )

    @property
    def question(self) -> Question:
        """The derivative of the output by the parameter, with the rigid limit as the truth."""
        return Question(np.array([self.theta]), abs(self.theta), self.truth, signals=(self.parameter, self.output))


def _outputs(outcome: Callable[[np.ndarray], np.ndarray], theta: np.ndarray) -> np.ndarray:
    return outcome(theta[:, 0])[:, None]


def _gradients(slope: Callable[[np.ndarray], np.ndarray], theta: np.ndarray) -> np.ndarray:
    return slope(theta[:, 0])[:, None, None]
