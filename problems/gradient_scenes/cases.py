"""What ``ocp gradients`` is asked: a scene or a file, and its worlds, by names."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ocp.errors import InputError
from ocp.gradients.worlds.report import Question
from ocp.gradients.worlds.world import World
from ocp.store.provenance import content_digest
from problems.gradient_scenes import SCENES, scene
from problems.gradient_scenes.own_world import OwnWorld, load_own_world
from problems.gradient_scenes.worlds import scene_world


@dataclass(frozen=True)
class GradientCase:
    """Question of a scene or a file, its worlds, and the digest of the files that define them."""

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
    """Return the case of a scene, or of a file that defines a world and its question.

    ``worlds`` are names of worlds and files; by default the exact law, and for a file its own world. ``settings`` set
    values of all worlds that have them.

    Raises :class:`~ocp.errors.InputError` for an unknown name, for a setting that no world has, and as
    :func:`~problems.gradient_scenes.own_world.load_own_world` does.
    """
    files: list[OwnWorld] = []

    def own_world(path: str) -> OwnWorld:
        files.append(load_own_world(path, parameter, output))
        return files[-1]

    if source.endswith(".py"):
        asked = own_world(source)
        if asked.question is None:
            raise InputError(
                f"{source}: the file must define theta, the parameters at which the gradient is asked for; or compare"
                f" it with a scene: ocp gradients oblique-drop --world {source}"
            )
        others = [own_world(name).world for name in worlds if name != source] if _all_files(worlds, source) else []
        name, title, question, chosen = asked.world.name, asked.world.name, asked.question, [asked.world, *others]
    else:
        known = scene(source)
        if parameter or output:
            raise InputError(f"the scene {source} has one parameter and one output; drop --parameter and --component")
        name, title, question = known.name, known.title, known.question
        names = list(worlds) or ["exact"]
        chosen = [own_world(each).world if each.endswith(".py") else scene_world(known, each) for each in names]
    if repeated := {world.name for world in chosen if [other.name for other in chosen].count(world.name) > 1}:
        raise InputError(f"the world {min(repeated)} is named twice; name it once")
    return GradientCase(
        name,
        title,
        question,
        _with_settings(chosen, settings or {}),
        content_digest([each.digest for each in files], {}),
    )


def _all_files(worlds: Sequence[str], source: str) -> bool:
    """Return whether all worlds are files; raise InputError otherwise, since named worlds cannot simulate a file."""
    for name in worlds:
        if not name.endswith(".py"):
            raise InputError(
                f"the world {name} simulates the scenes {', '.join(SCENES)}, and not {source}; name files as its worlds"
            )
    return True


def _with_settings(worlds: Sequence[World], settings: Mapping[str, float]) -> tuple[World, ...]:
    """Return the worlds at ``settings``; raise InputError for a setting that none of them has."""
    known = {name for world in worlds for name in world.settings}
    for name in settings:
        if name not in known:
            raise InputError(f"no world has a setting {name!r}; there are {', '.join(sorted(known)) or 'none'}")
    return tuple(
        world.at({name: value for name, value in settings.items() if name in world.settings}) for world in worlds
    )
