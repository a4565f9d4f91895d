"""Simulators of scenes by name: the closed form, our contact laws, penalty contacts, and MuJoCo."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from ocp.errors import choose
from ocp.gradients.worlds.world import World
from ocp.simulators.mujoco_rollouts import MujocoRollouts
from problems.gradient_scenes.mjcf import scene_mjcf
from problems.gradient_scenes.rigid_worlds import LAWS, law_world, penalty_world
from problems.gradient_scenes.scene import Scene

MUJOCO_SETTINGS = {"h": 0.002, "solref": 0.004}
"""Time step [s] and time constant of contacts [s] in MuJoCo; the time constant is at least two steps."""


def mujoco_world(scene: Scene) -> World:
    """Return the simulator of a scene in MuJoCo; its gradient multiplies MuJoCo's finite differences of all steps.

    Raises :class:`~ocp.errors.InputError` if MuJoCo is not installed.
    """
    rollouts, mechanics = MujocoRollouts(scene_mjcf(scene)), scene.mechanics
    start, push = mechanics.table[:2].ravel(), mechanics.table[2]
    by_start = np.concatenate([0 * push, push * mechanics.is_speed])
    by_force = push * (not mechanics.is_speed)

    def arguments(theta: np.ndarray, h: float, solref: float) -> tuple[np.ndarray, np.ndarray, int]:
        rollouts.set_contacts(h, solref)
        return start + theta * by_start, theta * by_force, max(1, round(scene.duration / h))

    def simulate(theta: np.ndarray, h: float, solref: float) -> np.ndarray:
        return rollouts.last_states(*arguments(theta, h, solref))[:, [scene.output_index]]

    def differentiate(theta: np.ndarray, h: float, solref: float) -> np.ndarray:
        derivatives = rollouts.derivatives(*arguments(theta, h, solref), by_start, by_force)
        return derivatives[:, [scene.output_index], None]

    return World(
        "mujoco",
        simulate,
        differentiate,
        MUJOCO_SETTINGS,
        sharper={"h": 0.5, "solref": 0.5},
        method="transitionFD",
        versions={"mujoco": rollouts.version},
        samples_gradient=False,
    )


WORLDS: dict[str, Callable[[Scene], World]] = {
    **{name: partial(law_world, name=name) for name in LAWS},
    "penalty": penalty_world,
    "mujoco": mujoco_world,
    "closed-form": lambda scene: scene.truth,
}
"""Mapping from the name of a world to the function that builds it for a scene."""


def scene_world(scene: Scene, name: str) -> World:
    """Return the simulator ``name`` of a scene; raise :class:`~ocp.errors.InputError` for an unknown name."""
    return choose("world", name, WORLDS)(scene)
