"""Input of ``ocp gradients``: a scene or a file, and the simulators to compare, given by name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from ocp.errors import InputError, choose
from ocp.gradients.worlds.report import Question
from ocp.gradients.worlds.world import World
from ocp.store.provenance import content_digest
from problems.gradient_scenes import SCENES
from problems.gradient_scenes.own_world import OwnWorld, load_own_world
from problems.gradient_scenes.worlds import scene_world

MAX_STEPS = 100_000
"""Maximum number of steps of a scene, before it is refined."""


@dataclass(frozen=True)
class GradientCase:
    """Derivative of a scene or a file, its simulators, and the digest of the files that define them."""

    name: str
    title: str
    question: Question
    worlds: tuple[World, ...]
    content: str


def gradient_case(
    source: str,
    worlds: Sequence[str] = (),
    settings: Mapping[str, float] | None = None,
    parameter: int = 0,
    output: int = 0,
) -> GradientCase:
    """Return the case of the scene ``source``, or of a file that defines a simulator and the derivative to be judged.

    ``worlds`` are names of simulators and files, by default the exact contact law for a scene; the simulator of a file
    ``source`` always comes first. ``settings`` maps names to values, for every simulator with a setting of that name.

    Raises :class:`~ocp.errors.InputError` for an unknown name, for a setting that no simulator has, and as
    :func:`~problems.gradient_scenes.own_world.load_own_world` does.
    """
    digests: list[str] = []

    def read(path: str) -> OwnWorld:
        user_world = load_own_world(path, parameter, output)
        digests.append(user_world.digest)
        return user_world

    if source.endswith(".py"):
        loaded, name = read(source), Path(source).stem
        title, question = name, loaded.question
        if question is None:
            raise InputError(
                f"{source}: the file must define theta, the parameters at which the gradient is asked for; or compare"
                f" it with a scene: ocp gradients oblique-drop --world {source}"
            )
        if named := [name for name in worlds if not name.endswith(".py")]:
            raise InputError(f"{named[0]} simulates the scenes {', '.join(SCENES)}, and not {source}; name files")
        chosen = [loaded.world, *(read(name).world for name in worlds)]
    else:
        scene = choose("scene", source, SCENES)
        _check_settings(settings or {}, scene.duration)
        if parameter or output:
            raise InputError(f"the scene {source} has one parameter and one output; drop --parameter and --component")
        name, title, question = scene.name, scene.title, scene.question
        chosen = [
            read(world).world if world.endswith(".py") else scene_world(scene, world) for world in worlds or ["exact"]
        ]
    names = [world.name for world in chosen]
    if len(set(names)) < len(names):
        raise InputError(f"a simulator is named twice among {', '.join(names)}; name it once")
    return GradientCase(name, title, question, _with_settings(chosen, settings or {}), content_digest(digests, {}))


def _check_settings(settings: Mapping[str, float], duration: float) -> None:
    """Raise InputError for settings of a scene's simulators that are not positive, or for a step out of range."""
    for name, value in settings.items():
        lower, upper = (duration / MAX_STEPS, duration) if name == "h" else (0.0, float("inf"))
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
