"""Simulators of scenes by name: the closed form, our contact laws, penalty contacts, MuJoCo, and MJX."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from ocp.errors import choose
from ocp.gradients.worlds.world import World
from ocp.simulators.mjx_rollouts import MjxRollouts
from ocp.simulators.mujoco_rollouts import MujocoRollouts
from problems.gradient_scenes.mjcf import scene_mjcf
from problems.gradient_scenes.rigid_worlds import LAWS, law_world, penalty_world
from problems.gradient_scenes.scene import Scene

MUJOCO_SETTINGS = {"h": 0.002, "solref": 0.004}
"""Time step [s] and time constant of contacts [s] in MuJoCo and MJX; the time constant is at least two steps."""


def _directions(scene: Scene) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the start (q, v) of a scene at theta = 0, and the derivatives of start and force by theta."""
    mechanics = scene.mechanics
    push = mechanics.table[2]
    by_start = np.concatenate([0 * push, push * mechanics.is_speed])
    return mechanics.table[:2].ravel(), by_start, push * (not mechanics.is_speed)


def _count_steps(scene: Scene, h: float) -> int:
    return max(1, round(scene.duration / h))


def mujoco_world(scene: Scene) -> World:
    """Return the simulator of a scene in MuJoCo; its gradient multiplies MuJoCo's finite differences of all steps.

    Raises :class:`~ocp.errors.InputError` if MuJoCo is not installed.
    """
    rollouts, (start, by_start, by_force) = MujocoRollouts(scene_mjcf(scene)), _directions(scene)

    def arguments(theta: np.ndarray, h: float, solref: float) -> tuple[np.ndarray, np.ndarray, int]:
        rollouts.set_contacts(h, solref)
        return start + theta * by_start, theta * by_force, _count_steps(scene, h)

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


def mjx_world(scene: Scene, reverse: bool = False) -> World:
    """Return the simulator of a scene in MJX, with pyramidal friction cones; its gradient is that of JAX.

    With elliptic cones the derivative of MJX is not a number. With ``reverse`` the gradient is accumulated backwards
    and the solver makes a single iteration, see :class:`~ocp.simulators.mjx_rollouts.MjxRollouts`.

    Raises :class:`~ocp.errors.InputError` if MJX is not installed.
    """
    rollouts = MjxRollouts(scene_mjcf(scene, "pyramidal"), *_directions(scene), scene.output_index, reverse)

    def run(function: Callable[..., np.ndarray], theta: np.ndarray, h: float, solref: float) -> np.ndarray:
        return function(theta[:, 0], _count_steps(scene, h), h, solref)

    return World(
        "mjx-reverse" if reverse else "mjx",
        lambda theta, h, solref: run(rollouts.entries, theta, h, solref)[:, None],
        lambda theta, h, solref: run(rollouts.slopes, theta, h, solref)[:, None, None],
        MUJOCO_SETTINGS,
        # Each number of steps is compiled anew for derivatives that are accumulated backwards.
        sharper={} if reverse else {"h": 0.5, "solref": 0.5},
        method="reverse AD" if reverse else "forward AD",
        versions=rollouts.versions,
        samples_gradient=False,
        compile=lambda note, h, solref: rollouts.compile(note, _count_steps(scene, h), h, solref),
    )


WORLDS: dict[str, Callable[[Scene], World]] = {
    **{name: partial(law_world, name=name) for name in LAWS},
    "penalty": penalty_world,
    "mujoco": mujoco_world,
    "mjx": mjx_world,
    "mjx-reverse": partial(mjx_world, reverse=True),
    "closed-form": lambda scene: scene.truth,
}
"""Mapping from the name of a world to the function that builds it for a scene."""


def scene_world(scene: Scene, name: str) -> World:
    """Return the simulator ``name`` of a scene; raise :class:`~ocp.errors.InputError` for an unknown name."""
    return choose("world", name, WORLDS)(scene)
