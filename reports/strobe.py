"""A strobe of the motion: the problem's own shapes at several instants, with contact forces."""

from __future__ import annotations

import math
from functools import singledispatch
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon, Rectangle
from matplotlib.transforms import Affine2D

from problems.drawing import Box, ContactFrame, Disc, HalfPlane, Point, Segment, Shape, Spring
from reports.style import BLUE, FAINT, GREEN, GREY, INK, ORANGE, VERMILLION, WIDTH
from reports.view import RunView

_COLORS = {"object": BLUE, "actuator": ORANGE, "environment": GREY, "goal": GREEN}
_INSTANTS = 7
_COILS = 6
_TALLEST = 3.3


def strobe(view: RunView) -> Figure | None:
    """Draw scenario 0 at several instants, early ones faint; None for a problem not drawn."""
    x = view.array("x")
    if view.spec is None or view.spec.draw is None or x is None:
        return None
    figure = Figure(figsize=(WIDTH, _TALLEST))
    axis = figure.subplots()
    draw_strobe(axis, view)
    ratio = np.ptp(axis.get_ylim()) / np.ptp(axis.get_xlim())
    figure.set_figheight(float(np.clip(0.9 * WIDTH * ratio + 0.7, 1.5, _TALLEST)))
    return figure


def draw_strobe(axis: Axes, view: RunView) -> None:
    """Draw the strobe into given axes."""
    spec, x = view.spec, view.array("x")
    assert spec is not None and spec.draw is not None and x is not None
    path = x[0]
    chosen = np.unique(np.linspace(0, len(path) - 1, min(_INSTANTS, len(path))).round().astype(int))
    frames = [spec.draw(view.params, path[node]) for node in chosen]
    fixed = set.intersection(*(set(shapes) for shapes in frames))
    _extent(axis, [shape for shapes in frames for shape in shapes])
    for shape in frames[0]:
        if shape in fixed:
            draw(shape, axis, 1.0)
    for strength, shapes in zip(np.linspace(0.2, 1, len(frames)), frames, strict=True):
        for shape in shapes:
            if shape not in fixed:
                draw(shape, axis, strength)
    _forces(axis, view, chosen)
    axis.set_xlabel(spec.axes[0])
    axis.set_ylabel(spec.axes[1])
    axis.set_axisbelow(True)


def _extent(axis: Axes, shapes: list[Shape]) -> None:
    """Fix the limits so that half planes and forces can be clipped to them."""
    points = np.array([point for shape in shapes for point in _corners(shape)])
    low, high = points.min(axis=0), points.max(axis=0)
    margin = 0.08 * float(max(high - low)) + 1e-9
    axis.set_xlim(low[0] - margin, high[0] + margin)
    axis.set_ylim(low[1] - margin, high[1] + margin)
    axis.set_aspect("equal")


def _corners(shape: Shape) -> list[tuple[float, float]]:
    match shape:
        case Disc(x, y, r):
            return [(x - r, y - r), (x + r, y + r)]
        case Box(x, y, width, height):
            reach = math.hypot(width, height) / 2
            return [(x - reach, y - reach), (x + reach, y + reach)]
        case Segment(x1, y1, x2, y2) | Spring(x1, y1, x2, y2):
            return [(x1, y1), (x2, y2)]
        case Point(x, y) | HalfPlane(x, y):
            return [(x, y)]


@singledispatch
def draw(shape: Any, axis: Axes, strength: float) -> None:
    """Draw one shape; ``strength`` in (0, 1] is how dark."""
    raise TypeError(f"no way to draw a {type(shape).__name__}")


def _face(role: str, strength: float) -> dict[str, Any]:
    color = _COLORS.get(role, GREY)
    return {"facecolor": (color, 0.25 * strength), "edgecolor": (color, strength), "linewidth": 0.9}


@draw.register
def _(shape: Disc, axis: Axes, strength: float) -> None:
    axis.add_patch(Circle((shape.x, shape.y), shape.radius, **_face(shape.role, strength)))


@draw.register
def _(shape: Box, axis: Axes, strength: float) -> None:
    box = Rectangle((-shape.width / 2, -shape.height / 2), shape.width, shape.height,
                    **_face(shape.role, strength))  # fmt: skip
    turned = Affine2D().rotate(shape.angle).translate(shape.x, shape.y)
    box.set_transform(turned + axis.transData)
    axis.add_patch(box)


@draw.register
def _(shape: Segment, axis: Axes, strength: float) -> None:
    axis.plot([shape.x1, shape.x2], [shape.y1, shape.y2], color=_COLORS.get(shape.role, GREY),
              alpha=strength, linewidth=1.6, solid_capstyle="round")  # fmt: skip


@draw.register
def _(shape: Spring, axis: Axes, strength: float) -> None:
    along = np.array([shape.x2 - shape.x1, shape.y2 - shape.y1])
    length = float(np.linalg.norm(along)) or 1.0
    across = np.array([-along[1], along[0]]) / length * 0.04
    place = np.linspace(0, 1, 2 * _COILS + 2)
    side = np.array([0, *([1, -1] * _COILS), 0])
    points = np.array([shape.x1, shape.y1]) + np.outer(place, along) + np.outer(side, across)
    axis.plot(points[:, 0], points[:, 1], color=_COLORS.get(shape.role, GREY), alpha=strength,
              linewidth=0.8)  # fmt: skip


@draw.register
def _(shape: Point, axis: Axes, strength: float) -> None:
    goal = shape.role == "goal"
    axis.plot([shape.x], [shape.y], marker="+" if goal else "o", markersize=11 if goal else 4.5,
              markeredgewidth=1.5 if goal else 0, color=_COLORS.get(shape.role, GREY),
              alpha=strength, linestyle="none", zorder=4 if goal else 2)  # fmt: skip


@draw.register
def _(shape: HalfPlane, axis: Axes, strength: float) -> None:
    normal = np.array([shape.nx, shape.ny])
    along = np.array([-shape.ny, shape.nx])
    reach = 4 * (np.ptp(axis.get_xlim()) + np.ptp(axis.get_ylim()))
    start = np.array([shape.x, shape.y])
    edge = [start - reach * along, start + reach * along]
    patch = Polygon([*edge, edge[1] - reach * normal, edge[0] - reach * normal],
                    facecolor=FAINT, edgecolor=GREY, linewidth=0.8, zorder=0)  # fmt: skip
    axis.add_patch(patch)


def _forces(axis: Axes, view: RunView, chosen: np.ndarray) -> None:
    """Arrows along the contact normals, the largest an eighth of the picture long."""
    spec, x, lam = view.spec, view.array("x"), view.array("lam")
    if spec is None or spec.frames is None or x is None or lam is None:
        return
    signals = view.signals("contacts")
    # lam of a law averaged over noise has one block a node; the mean is what moves the system.
    force = np.stack(
        [lam[0, :, i :: len(signals)].mean(axis=-1) for i in range(len(signals))], axis=1
    )
    largest = float(np.nanmax(np.abs(force), initial=0.0))
    if not largest > 0:
        return
    scale = 0.18 * max(np.ptp(axis.get_xlim()), np.ptp(axis.get_ylim())) / largest
    for node in range(1, len(x[0])):
        frames: list[ContactFrame] = spec.frames(view.params, x[0, node])
        for frame, value in zip(frames, force[node - 1], strict=False):
            if value < 0.02 * largest:
                continue
            shown = node in chosen
            axis.annotate(
                "", xytext=(frame.x, frame.y), zorder=5,
                xy=(frame.x + scale * value * frame.nx, frame.y + scale * value * frame.ny),
                arrowprops={"arrowstyle": "-|>", "color": VERMILLION, "linewidth": 1.0,
                            "shrinkA": 0, "shrinkB": 0, "alpha": 1.0 if shown else 0.35,
                            "mutation_scale": 6},
            )  # fmt: skip
    which = f"scenario 0 of {len(x)}; " if len(x) > 1 else ""
    text = f"{which}arrows: contact, the longest is {largest:.3g} {signals[0].unit}"
    axis.set_title(text, loc="left", color=INK)
