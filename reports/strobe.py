"""A strobe of the motion: the problem's own shapes at several instants, with contact forces."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from problems.drawing import Shape
from reports.forces import Forces, caption, draw_contacts, forces_of
from reports.shapes import bounds, draw, show
from reports.style import INK, WIDTH
from reports.view import RunView

_FEWEST, _MOST = 3, 7
_TALLEST, _SMALL = 3.1, 1.7
MOST_SCENARIOS = 12


def strobe(view: RunView, cones: bool = False) -> Figure | None:
    """Draw scenario 0 at several instants, early ones faint; None for a problem not drawn.

    Friction cones are drawn where ``cones``.
    """
    if not drawable(view):
        return None
    figure = Figure(figsize=(WIDTH, _TALLEST))
    axis = figure.subplots()
    draw_strobe(axis, view, cones)
    ratio = np.ptp(axis.get_ylim()) / np.ptp(axis.get_xlim())
    figure.set_figheight(float(np.clip(0.9 * WIDTH * ratio + 0.7, 1.3, _TALLEST)))
    return figure


def drawable(view: RunView) -> bool:
    """Whether the run has states, and its problem a drawing."""
    return view.picture is not None


def picked_scenarios(count: int) -> list[int]:
    """Numbers of the scenarios that are drawn."""
    most = min(count, MOST_SCENARIOS)
    return [int(index) for index in np.linspace(0, count - 1, most).round()]


def strobe_rows(
    shown: Sequence[tuple[str, RunView]], cones: bool = False
) -> tuple[list[Figure], str]:
    """Strobes beside each other under their titles, of scenario 0 each, in rows of one figure each.

    All have the same limits, and their arrows one scale, given in the returned caption.
    """
    if not shown:
        return [], ""
    forces = [found for _, view in shown if (found := _forces_drawn(view)) is not None]
    largest = max((found.largest for found in forces), default=0.0)
    count = len(shown)
    columns = {1: 1, 2: 2, 4: 2}.get(count, 4 if count in (7, 8) or count > 9 else 3)
    figures, used = list[Figure](), list[Axes]()
    for start in range(0, len(shown), columns):
        figure = Figure(figsize=(WIDTH, _SMALL))
        axes = figure.subplots(1, columns, squeeze=False)[0]
        for axis, (title, view) in zip(axes, shown[start : start + columns], strict=False):
            draw_strobe(axis, view, cones, largest)
            axis.set_title(title, loc="left", fontsize=7.5)
            axis.tick_params(labelsize=7)
            axis.set_xlabel(axis.get_xlabel(), fontsize=7)
            axis.set_ylabel(axis.get_ylabel() if axis is axes[0] else "", fontsize=7)
            used.append(axis)
        for axis in axes[len(shown) - start :]:
            axis.set_axis_off()
        figures.append(figure)
    height = _one_view(used) * 0.85 * WIDTH / columns + 0.55
    for figure in figures:
        figure.set_figheight(float(np.clip(height, 1.0, _TALLEST)))
    return figures, caption(largest, forces[0].unit, cones) if largest > 0 else ""


def _one_view(axes: Sequence[Axes]) -> float:
    """Give all axes the limits that hold each of theirs; returns their height over their width."""
    limits = np.array([[axis.get_xlim(), axis.get_ylim()] for axis in axes])
    low, high = limits[..., 0].min(axis=0), limits[..., 1].max(axis=0)
    for axis in axes:
        axis.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    return float((high - low)[1] / (high - low)[0])


def draw_strobe(
    axis: Axes, view: RunView, cones: bool = False, largest: float | None = None
) -> None:
    """Draw the strobe of scenario 0 into given axes, forces on the bodies that are drawn.

    A force of ``largest``, if not given the largest of the run, has the longest arrow.
    """
    picture = view.picture
    assert picture is not None
    forces = _forces_drawn(view)
    plays = picture.shapes("", view.time)
    chosen = draw_motion(axis, plays, None if forces is None else _strongest(forces))
    if forces is not None:
        most = forces.largest if largest is None else largest
        acting = chosen[chosen > 0]
        for node, frames in zip(acting, picture.contacts("", view.time[acting]), strict=True):
            pushes = forces.normal[node - 1], forces.friction[node - 1]
            draw_contacts(axis, frames, pushes, most, cones=0.5 if cones else 0)
        if most > 0:
            axis.set_title(caption(most, forces.unit, cones), loc="left", color=INK)
    axis.set_xlabel(picture.axes[0])
    axis.set_ylabel(picture.axes[1])
    axis.set_axisbelow(True)


def _strongest(forces: Forces) -> int | None:
    """The node at the end of the step with the largest force."""
    size = np.nan_to_num(np.hypot(forces.normal, forces.friction))
    return int(size.max(axis=1).argmax()) + 1 if size.size and size.max() > 0 else None


def draw_motion(axis: Axes, plays: list[list[Shape]], strongest: int | None = None) -> np.ndarray:
    """Draw shapes at several of the instants of ``plays``, early ones faint; gives the instants.

    The instant ``strongest`` is one of them.
    """
    chosen = _instants(plays)
    if strongest is not None and len(chosen) > 2:
        inner = 1 + int(np.abs(chosen[1:-1] - strongest).argmin())
        if strongest not in chosen:
            chosen[inner] = strongest
    frames = [plays[node] for node in chosen]
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


def _instants(plays: list[list[Shape]]) -> np.ndarray:
    """A few evenly spaced nodes: fewer where bodies hardly move."""
    still = set.intersection(*(set(shapes) for shapes in plays))
    boxes = np.array([bounds(s for s in shapes if s not in still) for shapes in plays])
    count = _FEWEST
    if np.isfinite(boxes).all():
        way = np.abs(np.diff(boxes.mean(axis=1), axis=0)).sum(axis=0)
        size = np.maximum((boxes[:, 1] - boxes[:, 0]).max(axis=0), 1e-9)
        count = int(min(_MOST, _FEWEST + 4 * np.max(way / size)))
    return np.unique(np.linspace(0, len(plays) - 1, count).round().astype(int))


def _forces_drawn(view: RunView) -> Forces | None:
    """The forces, if the problem has contact frames."""
    return forces_of(view) if view.picture is not None and view.picture.framed else None
