"""Input of ``ocp gradients``: a scene, a file or a plan, and the simulators to compare, given by name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ocp.errors import InputError, choose
from ocp.gradients.worlds.plans import plan_questions
from ocp.gradients.worlds.report import Question
from ocp.gradients.worlds.world import World
from ocp.solution import Solution
from ocp.store.provenance import content_digest
from problems.gradient_scenes import SCENES
from problems.gradient_scenes.own_world import OwnWorld, load_own_world
from problems.gradient_scenes.worlds import scene_world

MAX_STEPS = 100_000
"""Maximum number of steps of a scene, before it is refined."""


@dataclass(frozen=True)
class GradientCase:
    """Derivatives of a scene, a file or a plan, its simulators, and the digest of the files that define them.

    ``plan`` is the hash of the run with the plan, "" otherwise.
    """

    name: str
    title: str
    questions: Sequence[Question]
    worlds: tuple[World, ...]
    content: str
    plan: str = ""


def gradient_case(
    source: str | Solution,
    worlds: Sequence[str] = (),
    settings: Mapping[str, float] | None = None,
    parameter: int = 0,
    output: int = 0,
    seed: int = 0,
) -> GradientCase:
    """Return the case of the scene ``source``, of a file that defines a simulator and a derivative, or of a plan.

    ``worlds`` are names of simulators and files, by default the exact contact law; the simulator of a file ``source``
    always comes first. ``settings`` maps names to values, for every simulator with a setting of that name. ``seed``
    determines the directions in which the inputs of a plan are changed.

    Raises :class:`~ocp.errors.InputError` for an unknown name, for a setting that no simulator has, and as
    :func:`~problems.gradient_scenes.own_world.load_own_world` and
    :func:`~ocp.gradients.worlds.plans.plan_questions` do.
    """
    digests, named, settings = list[str](), list(worlds) or ["exact"], settings or {}
    if (parameter or output) and not str(source).endswith(".py"):
        raise InputError(f"--parameter and --component choose entries of a file, and {source} is none; drop them")

    def read(path: str) -> OwnWorld:
        user_world = load_own_world(path, parameter, output)
        digests.append(user_world.digest)
        return user_world

    if isinstance(source, Solution):
        _check_settings(settings, np.inf)
        name, title = source.problem.name, f"The cost of a plan of {source.problem.name} by its inputs"
        questions, chosen = plan_questions(source, named, lambda path: read(path).world, seed)
    elif source.endswith(".py"):
        loaded, name = read(source), Path(source).stem
        if loaded.question is None:
            raise InputError(
                f"{source}: the file must define theta, the parameters at which the gradient is asked for; or compare"
                f" it with a scene: ocp gradients oblique-drop --world {source}"
            )
        if scene_worlds := [world for world in worlds if not world.endswith(".py")]:
            raise InputError(
                f"{scene_worlds[0]} simulates the scenes {', '.join(SCENES)}, and not {source}; name files"
            )
        title, questions = name, [loaded.question]
        chosen = [loaded.world, *(read(world).world for world in worlds)]
    else:
        scene = choose("scene", source, SCENES)
        _check_settings(settings, scene.duration)
        name, title, questions = scene.name, scene.title, [scene.question]
        chosen = [read(world).world if world.endswith(".py") else scene_world(scene, world) for world in named]
    names = [world.name for world in chosen]
    if len(set(names)) < len(names):
        raise InputError(f"a simulator is named twice among {', '.join(names)}; name it once")
    content, plan = content_digest(digests, {}), getattr(source, "run_hash", "")
    return GradientCase(name, title, questions, _with_settings(chosen, settings), content, plan)


def _check_settings(settings: Mapping[str, float], duration: float) -> None:
    """Raise InputError for settings of simulators that are not positive, or for a step out of range."""
    for name, value in settings.items():
        lower, upper = (duration / MAX_STEPS, duration) if name == "h" else (0.0, np.inf)
        if not lower < value <= upper:
            raise InputError(f"-s {name} must be > {lower:.3g}{f' and <= {upper:g}' * (name == 'h')}, got {value:g}")


def _with_settings(worlds: Sequence[World], settings: Mapping[str, float]) -> tuple[World, ...]:
    """Return the simulators with ``settings`` applied; raise InputError for a setting that no simulator has."""
    setting_names = sorted({name for world in worlds for name in world.settings})
    if unknown := [name for name in settings if name not in setting_names]:
        raise InputError(f"no simulator has a setting {unknown[0]!r}; there are {', '.join(setting_names) or 'none'}")
    return tuple(
        world.at({name: value for name, value in settings.items() if name in world.settings}) for world in worlds
    )
