"""Checks of a scene: names, sizes, masses, and bodies that start inside each other."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from dynamics.systems import ParameterTable
from dynamics.systems.shapes import Box, Capsule, Disc, HalfPlane, Polygon, Shape
from dynamics.systems.shapes.planar import Point, Scalar
from dynamics.systems.shapes.polygon import convex_parts, is_clockwise, polygon_defect
from ocp.errors import InputError, did_you_mean
from problems.scenes.things import Body, Goal, Pusher, Thing

if TYPE_CHECKING:
    from problems.scenes.scene import Scene

Value = Callable[[Scalar], float]
START_DEPTH_M = 1e-9
"""Maximum depth to which things may start inside each other [m]."""


def check_names(elements: Sequence[Thing | Goal], pairs: Sequence[tuple[str, str]]) -> None:
    """Raise :class:`~ocp.errors.InputError` for unsupported elements, duplicate names, and unknown names."""
    for element in elements:
        if isinstance(element, Body | Pusher) and isinstance(element.shape, HalfPlane):
            raise InputError(
                f"{element.name!r} moves, and a half-plane is unbounded; make it an Obstacle, or its shape a Box"
            )
    names = [element.name for element in elements if isinstance(element, Thing)]
    duplicates = [name for name, count in Counter(names).items() if count > 1]
    if duplicates:
        raise InputError(f"two things are called {duplicates[0]!r}; give each its own name")
    moving = {element.name: element for element in elements if isinstance(element, Body | Pusher)}
    if not moving:
        raise InputError("nothing in the scene moves; add a Body or a Pusher")
    for goal in (element for element in elements if isinstance(element, Goal)):
        _require_known(goal.body, list(moving), "a goal is for")
    for pair in pairs:
        if isinstance(pair, str) or len(pair) != 2:
            raise InputError(f"{pair!r} is not a pair of names; expected ('one', 'other')")
        for name in pair:
            _require_known(name, names, "a pair names")
        if pair[0] == pair[1]:
            raise InputError(f"{pair[0]!r} cannot touch itself; a pair needs two names")
        if not any(name in moving for name in pair):
            raise InputError(f"{pair[0]!r} and {pair[1]!r} are obstacles and never touch")


def _require_known(name: str, names: list[str], role: str) -> None:
    if name not in names:
        raise InputError(f"{role} {name!r}{did_you_mean(name, names)}; there are {', '.join(names)}")


def required(pusher: Pusher, value: Scalar | None, label: str, scene_kind: str) -> Scalar:
    """Return ``value``, the property ``label`` of a pusher; raise :class:`~ocp.errors.InputError` if it is None."""
    if value is None:
        raise InputError(f"the pusher {pusher.name!r} has no {label}, required in {scene_kind}; set it")
    return value


def check_numbers(scene: Scene, parameters: ParameterTable) -> None:
    """Raise :class:`~ocp.errors.InputError` for invalid sizes and masses, and for shapes that overlap at the start.

    All expressions are evaluated at the values of ``parameters``.
    """
    symbols, values = parameters.vector, parameters.values

    def value(expression: Scalar) -> float:
        return float(ca.Function("value", [symbols], [ca.densify(ca.SX(expression))])(values))

    for element in scene.things:
        for shape in convex_parts(element.shape):
            _check_shape(element, shape, value)
        for quantity in ("mass", "inertia", "stiffness", "table", "reach"):
            number = getattr(element, quantity, None)
            if number is not None and not value(number) > 0:
                raise InputError(f"{element.name!r} has the {quantity} {value(number):g}; expected a positive number")
        if isinstance(element, Pusher) and element.axis is not None:
            _check_unit(f"the rail of {element.name!r} runs along", element.axis, value)
    for i, touch in enumerate(scene.touches):
        if value(scene.friction[i]) < 0:
            raise InputError(
                f"{touch.name}: Coulomb's coefficient is {value(scene.friction[i]):g}; expected a number >= 0"
            )
    gaps = ca.Function("gaps", [symbols], [ca.densify(scene.distance(scene.start))])
    distances = np.array(gaps(values)).ravel()
    if distances.size and (deepest := int(distances.argmin())) >= 0:
        touch, depth = scene.touches[deepest], -distances[deepest]
        if depth > START_DEPTH_M:
            raise InputError(
                f"{touch.one.name!r} starts {depth:.3g} m inside {touch.other.name!r}; move one of them by as much"
            )


def _check_shape(element: Thing, shape: Shape, value: Value) -> None:
    match shape:
        case Disc(radius):
            _check_size(element, "disc has the radius", value(radius))
        case Capsule(start, end, radius):
            _check_size(element, "capsule has the radius", value(radius))
            length = math.hypot(*(value(end[i] - start[i]) for i in range(2)))
            _check_size(element, "capsule has the length", length)
        case Box(half, radius):
            half_sides = [value(half[i]) for i in range(2)]
            _check_size(element, "box has a half side of", min(half_sides))
            if not 0 <= value(radius) <= min(half_sides):
                raise InputError(
                    f"the corners of {element.name!r} are rounded by {value(radius):g} m; expected"
                    f" at least 0 and at most half its shorter side, {min(half_sides):g} m"
                )
        case Polygon(vertices, radius):
            corners = np.array([[value(vertex[i]) for i in range(2)] for vertex in vertices])
            if defect := polygon_defect(corners, value(radius)):
                raise InputError(f"the polygon of {element.name!r} {defect}")
            if is_clockwise(corners):
                raise InputError(
                    f"the polygon of {element.name!r} runs clockwise; give vertices with symbols counterclockwise"
                )
        case HalfPlane(_, normal):
            _check_unit(f"the half-plane of {element.name!r} has the normal", normal, value)


def _check_size(element: Thing, label: str, size: float) -> None:
    if not size > 0:
        raise InputError(f"{element.name!r}: its {label} {size:g} m; expected a positive number")


def _check_unit(label: str, vector: Point, value: Value) -> None:
    x, y = (value(vector[i]) for i in range(2))
    if not math.isclose(math.hypot(x, y), 1, rel_tol=1e-6):
        raise InputError(f"{label} ({x:g}, {y:g}) of length {math.hypot(x, y):g}; expected a vector of length 1")
