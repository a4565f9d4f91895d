"""A strobe of the motion: the problem's own shapes at several instants, with contact forces."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from problems.drawing import Shape
from reports.camera import show
from reports.forces import caption, draw_contacts, forces_of
from reports.shapes import bounds, draw
from reports.style import INK, WIDTH
from reports.view import RunView

_FEWEST, _MOST = 3, 7
_TALLEST = 3.3
_BETWEEN = 80
"""Nodes up to which forces between the instants are drawn too; of more they would hide it all."""


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
    chosen = draw_motion(axis, [spec.draw(view.params, state) for state in x[0]])
    _forces(axis, view, chosen)
    axis.set_xlabel(spec.axes[0])
    axis.set_ylabel(spec.axes[1])
    axis.set_axisbelow(True)


def draw_motion(axis: Axes, plays: list[list[Shape]]) -> np.ndarray:
    """Draw shapes at several of the instants of ``plays``, early ones faint; gives the instants."""
    frames, chosen = _instants(plays)
    fixed = set.intersection(*(set(shapes) for shapes in frames))
    show(axis, [shape for shapes in frames for shape in shapes])
    for shape in frames[0]:
        if shape in fixed:
            draw(shape, axis, 1.0)
    for strength, shapes in zip(np.linspace(0.2, 1, len(frames)), frames, strict=True):
        for shape in shapes:
            if shape not in fixed:
                draw(shape, axis, strength)
    return chosen


def _instants(plays: list[list[Shape]]) -> tuple[list[list[Shape]], np.ndarray]:
    """Shapes of a few nodes evenly apart, and the nodes: fewer where bodies hardly move away."""
    still = set.intersection(*(set(shapes) for shapes in plays))
    boxes = np.array([bounds(s for s in shapes if s not in still) for shapes in plays])
    count = _FEWEST
    if np.isfinite(boxes).all():
        way = np.abs(np.diff(boxes.mean(axis=1), axis=0)).sum(axis=0)
        size = np.maximum((boxes[:, 1] - boxes[:, 0]).max(axis=0), 1e-9)
        count = int(min(_MOST, _FEWEST + 4 * np.max(way / size)))
    chosen = np.unique(np.linspace(0, len(plays) - 1, count).round().astype(int))
    return [plays[node] for node in chosen], chosen


def _forces(axis: Axes, view: RunView, chosen: np.ndarray) -> None:
    """Arrows from the contacts, those between the instants faint, and cones of friction."""
    spec, x, forces = view.spec, view.array("x"), forces_of(view)
    if spec is None or spec.frames is None or x is None or forces is None:
        return
    largest = forces.largest
    if not largest > 0:
        return
    for node in range(1, len(x[0])) if len(x[0]) <= _BETWEEN else chosen[chosen > 0]:
        frames = spec.frames(view.params, x[0, node])
        pushes = forces.normal[node - 1], forces.friction[node - 1]
        strength = {"alpha": 1.0, "cones": 0.5} if node in chosen else {"alpha": 0.35, "cones": 0}
        draw_contacts(axis, frames, pushes, largest, **strength)
    which = f"scenario 0 of {len(x)}; " if len(x) > 1 else ""
    rough = any(frame.friction for frame in spec.frames(view.params, x[0, 0]))
    axis.set_title(which + caption(largest, forces.unit, rough), loc="left", color=INK)
