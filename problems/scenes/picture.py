"""The drawing of a scene, made from the shapes whose distances are its gaps."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import Any

import casadi as ca
import numpy as np

from problems.drawing import ContactFrame, Disc, Segment, Shape, solid
from problems.scenes.scene import Scene
from problems.scenes.things import Body, Obstacle, Thing

Draw = Callable[[Any, np.ndarray], list[Shape]]
Frames = Callable[[Any, np.ndarray], list[ContactFrame]]
Place = tuple[float, float, float]
"""x, y [m], and the angle [rad], clockwise."""


def pictured(scene: Callable[[Any], Scene]) -> tuple[Draw, Frames]:
    """Return the ``draw`` and ``frames`` of a problem whose scene is ``scene(p)``.

    ``scene`` reads every parameter as ``p["name"]``, so that it serves the symbols of ``build`` and
    the numbers of a drawing alike.
    """

    @cache
    def made(params: Any) -> tuple[Scene, ca.Function]:
        found = scene(params.model_dump())
        return found, _places(found)

    def draw(params: Any, state: np.ndarray) -> list[Shape]:
        there, places = made(params)
        poses = np.array(places(state[: places.numel_in(0)])[0]).T.tolist()
        return _shapes(there, [(x, y, angle) for x, y, angle in poses])

    def frames(params: Any, state: np.ndarray) -> list[ContactFrame]:
        places = made(params)[1]
        _, found, friction = (np.array(v).T for v in places(state[: places.numel_in(0)]))
        rows = np.column_stack([found, friction.ravel()]).tolist()
        return [ContactFrame(x, y, nx, ny, f) for x, y, nx, ny, f in rows]

    return draw, frames


def _places(scene: Scene) -> ca.Function:
    """Map q to the poses (3, things), to places and normals (4, contacts), and their friction."""
    q = ca.SX.sym("q", len(scene.coordinates))
    pose, poses = scene.pose(q), ca.SX(3, 0)
    for thing in scene.things:
        at = pose(thing)
        poses = ca.horzcat(poses, ca.vertcat(at.position, at.angle))
    frames = ca.SX(4, 0)
    for contact in scene.contacts(q):
        frames = ca.horzcat(frames, ca.vertcat(contact.point, contact.normal))
    outputs = [poses, frames, scene.friction]
    return ca.Function("places", [q], [ca.densify(out) for out in outputs])


def _shapes(scene: Scene, poses: list[Place]) -> list[Shape]:
    """Obstacles, then goals, then what moves."""
    there = {thing.name: thing for thing in scene.things}
    placed = list(zip(scene.things, poses, strict=True))
    still = [(thing, at) for thing, at in placed if isinstance(thing, Obstacle)]
    moving = [(thing, at) for thing, at in placed if not isinstance(thing, Obstacle)]
    found = [solid(thing.shape, *at, "environment") for thing, at in still]
    for goal in scene.goals:
        pose = float(goal.at[0]), float(goal.at[1]), -float(goal.angle)
        found += _marked(there[goal.body], pose, "goal")
    for thing, at in moving:
        found += _marked(thing, at, "object" if isinstance(thing, Body) else "actuator")
    return found


def _marked(thing: Thing, at: Place, role: str) -> list[Shape]:
    """The thing, and on a disc that turns the radius that is upright at angle zero."""
    drawn = solid(thing.shape, *at, role)
    if not (thing.turns and isinstance(drawn, Disc)):
        return [drawn]
    x, y, angle = drawn.x, drawn.y, at[2]
    end = x + drawn.radius * math.sin(angle), y + drawn.radius * math.cos(angle)
    return [drawn, Segment(x, y, *end, role)]
