"""Pictures of a scene: its shapes at one state, and the frames of its contacts."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import Any

import casadi as ca
import numpy as np

from dynamics.systems.shapes.polygon import convex_parts
from problems.drawing import Circle, ContactFrame, Segment, Shape, solid
from problems.scenes.scene import Scene
from problems.scenes.things import Body, Obstacle, Thing

Draw = Callable[[Any, np.ndarray], list[Shape]]
Frames = Callable[[Any, np.ndarray], list[ContactFrame]]
PlanarPose = tuple[float, float, float]
"""Pose of a thing: x, y [m], and the clockwise angle [rad]."""


def drawing_functions(scene: Callable[[Any], Scene]) -> tuple[Draw, Frames]:
    """Return the functions ``draw`` and ``frames`` of a problem whose scene is ``scene(p)``.

    ``scene`` must read every parameter as ``p["name"]``, so that it accepts the symbols of ``build`` and
    the numbers of a drawing.
    """

    @cache
    def built_scene(params: Any) -> tuple[Scene, ca.Function]:
        scene_of_numbers = scene(params.model_dump())
        return scene_of_numbers, _poses_and_contacts(scene_of_numbers)

    def draw(params: Any, state: np.ndarray) -> list[Shape]:
        pictured_scene, poses_and_frames = built_scene(params)
        poses = np.array(poses_and_frames(state[: poses_and_frames.numel_in(0)])[0]).T.tolist()
        return _all_shapes(pictured_scene, [(x, y, angle) for x, y, angle in poses])

    def frames(params: Any, state: np.ndarray) -> list[ContactFrame]:
        poses_and_frames = built_scene(params)[1]
        _, contacts, friction = (np.array(v).T for v in poses_and_frames(state[: poses_and_frames.numel_in(0)]))
        rows = np.column_stack([contacts, friction.ravel()]).tolist()
        return [ContactFrame(*row) for row in rows]

    return draw, frames


def _poses_and_contacts(scene: Scene) -> ca.Function:
    """Return the function from q to poses (3, n), points and normals (4, contacts), and friction (contacts,)."""
    q = ca.SX.sym("q", len(scene.coordinates))
    poses = [ca.vertcat(pose.position, pose.angle) for pose in map(scene.pose(q), scene.things)]
    frames = [ca.vertcat(contact.point, contact.normal) for contact in scene.contacts(q)]
    outputs = [ca.horzcat(ca.SX(3, 0), *poses), ca.horzcat(ca.SX(4, 0), *frames), scene.friction]
    return ca.Function("places", [q], [ca.densify(output) for output in outputs])


def _all_shapes(scene: Scene, poses: list[PlanarPose]) -> list[Shape]:
    """Return the shapes of obstacles, then of goals, then of bodies and pushers."""
    obstacles, goals, moving = list[Shape](), list[Shape](), list[Shape]()
    for element, pose in zip(scene.things, poses, strict=True):
        if isinstance(element, Obstacle):
            obstacles += [solid(shape, *pose, "environment") for shape in convex_parts(element.shape)]
        else:
            moving += _shapes(element, pose, "object" if isinstance(element, Body) else "actuator")
    bodies = {body.name: body for body in scene.moving}
    for goal in scene.goals:
        goals += _shapes(bodies[goal.body], (float(goal.at[0]), float(goal.at[1]), -float(goal.angle)), "goal")
    return [*obstacles, *goals, *moving]


def _shapes(element: Thing, pose: PlanarPose, role: str) -> list[Shape]:
    """Return the shapes to draw for an element; a rotating disc has a radius, which points upwards at angle zero."""
    shapes = [solid(shape, *pose, role) for shape in convex_parts(element.shape)]
    if not (element.turns and isinstance(disc := shapes[0], Circle)):
        return shapes
    end = disc.x + disc.radius * math.sin(pose[2]), disc.y + disc.radius * math.cos(pose[2])
    return [*shapes, Segment(disc.x, disc.y, *end, role)]
