"""MJX in scenes: flight in closed form, rollouts of MuJoCo itself, and both directions of differentiation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ocp.gradients.worlds import ReportSettings
from ocp.jobs.gradients import measure_worlds
from ocp.simulators.mujoco_rollouts import MujocoRollouts
from problems.gradient_scenes import SCENES
from problems.gradient_scenes.mjcf import scene_mjcf
from problems.gradient_scenes.scene import GRAVITY
from problems.gradient_scenes.scenes import HEIGHT_M
from problems.gradient_scenes.worlds import scene_world

pytestmark = pytest.mark.slow
pytest.importorskip("mujoco.mjx")


@pytest.mark.parametrize("name", ["mjx", "mjx-reverse"])
def test_flight_is_the_closed_form_in_both_directions_of_differentiation(name: str) -> None:
    """Semi-implicit steps give z = v T - g T (T + h)/2, whose derivative by v is T."""
    scene = replace(SCENES["bounce"], duration=0.1)
    world, notes = scene_world(scene, name), list[str]()
    v = np.array([[-1.0], [0.5]])
    world = replace(world, note=notes.append)
    world.prepare()
    assert len(notes) == 4 and notes[0] == "JAX compiles rollouts" and notes[1].startswith("compiled in ")
    expected = HEIGHT_M + v * 0.1 - GRAVITY * 0.1 * (0.1 + world.settings["h"]) / 2
    np.testing.assert_allclose(world.rollout(v), expected, rtol=1e-12)
    np.testing.assert_allclose(world.gradient(v)[:, 0, 0], 0.1, rtol=1e-12)
    world.prepare()
    assert len(notes) == 4 and set(world.versions) == {"mujoco", "mujoco-mjx", "jax"}


def test_rollouts_are_those_of_mujoco_and_the_derivative_is_that_of_differences() -> None:
    """The ball's place of rest after an impact and a slide, with MuJoCo's pyramidal cones; at finer settings too."""
    scene = SCENES["oblique-drop"]
    world, rollouts = scene_world(scene, "mjx"), MujocoRollouts(scene_mjcf(scene, "pyramidal"))
    theta = scene.theta * np.linspace(0.9, 1.1, 70)[:, None]
    start, push = scene.mechanics.table[:2].ravel(), np.append(np.zeros(2), scene.mechanics.table[2])
    for factor in (1.0, 0.5):
        h, solref = (factor * world.settings[name] for name in ("h", "solref"))
        rollouts.set_contacts(h, solref)
        last = rollouts.last_states(start + theta * push, np.zeros((70, 2)), round(scene.duration / h))
        fine = world.at({"h": h, "solref": solref})
        np.testing.assert_allclose(fine.rollout(theta)[:, 0], last[:, 0], atol=1e-6)
    a = 1e-7
    differences = (world.rollout(theta + a) - world.rollout(theta - a))[:, 0] / (2 * a)
    errors = np.abs(world.gradient(theta)[:, 0, 0] - differences) / (1 + np.abs(differences))
    assert np.median(errors) < 1e-4


@pytest.mark.parametrize(("name", "verdict"), [("push-from-afar", "zero"), ("corner", "undefined")])
def test_verdicts_that_no_roughness_changes(name: str, verdict: str) -> None:
    (row,) = measure_worlds(
        [scene_world(SCENES[name], "mjx")], SCENES[name].question, ReportSettings(samples=100, refinements=0)
    ).rows
    assert row["verdict"] == verdict, row["sentence"]
    assert row["method"] == "forward AD" and row["versions"]["jax"]
