"""Stroboscopic drawings (strobes) of a motion, with contact forces as arrows and friction cones."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from textwrap import fill

import casadi as ca
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.path import Path

from problems.drawing import ContactFrame, Shape
from reports.drawing.shapes import Stroke, bounds, constant_shapes, draw, is_opaque, name_axes, show
from reports.drawing.style import INK, PURPLE, VERMILLION, WIDTH
from reports.drawing.view import RunView

LEAST = 0.02
"""Fraction of the largest force below which a force is not drawn."""
_ARROW_OF_LONG_SIDE = 0.18
"""Length of the longest arrow, as a fraction of the longer side of the view."""
_ARROW_OF_SHORT_SIDE = 0.4
"""Length of the longest arrow, as a fraction of the shorter side of the view."""
_CONE_ARROWS = 0.7
"""Length of a drawn friction cone, as a fraction of the longest arrow."""


def largest_size(values: np.ndarray | None) -> float:
    """Return the largest magnitude among the finite values, 0 if there are none."""
    if values is None:
        return 0.0
    return float(np.max(np.abs(values[np.isfinite(values)]), initial=0.0))


@dataclass(frozen=True)
class Forces:
    """Forces of every contact over a trajectory, in scenario 0.

    ``normal`` and ``friction`` (N, points) are along the normal and the tangent of the contact's
    :class:`~problems.drawing.ContactFrame`, both in ``unit``: impulses of one step [N s], or forces [N]
    if the system's multipliers are forces.
    """

    normal: np.ndarray
    friction: np.ndarray
    unit: str

    @property
    def largest(self) -> float:
        """Magnitude of the largest finite force, 0 if there are none."""
        return largest_size(np.hypot(self.normal, self.friction))


def forces_of(view: RunView, suffix: str = "") -> Forces | None:
    """Return the forces of the plan, or of its replay (suffix ``"_replay"``); None without multipliers.

    The forces are the stored ``normal_impulse`` and ``friction_impulse``. If these are missing, the system's
    map from multipliers to forces is used; if this map is unknown, every multiplier counts as a normal impulse.
    """
    lam = view.array(f"lam{suffix}")
    if lam is None:
        return None
    normal, friction = (view.array(f"{kind}_impulse{suffix}") for kind in ("normal", "friction"))
    if normal is not None and friction is not None:
        return Forces(normal[0], friction[0], "N s")
    signals = view.signals("contacts")
    # lam of a law averaged over noise has one block per node of the noise; their mean moves the system.
    mean = [lam[0, :, i :: len(signals)].mean(axis=-1) for i in range(len(signals))]
    pushed = np.stack(mean, axis=1) if mean else np.zeros((lam.shape[1], 0))
    if view.problem is not None and (force_map := view.problem.system.forces) is not None:
        system, parameters = view.problem.system, view.problem.parameters
        outputs = [force_map.normal, force_map.tangential]
        force_function = ca.Function("forces", [system.lam, parameters.vector], outputs)
        normal, tangential = (np.asarray(forces).T for forces in force_function(pushed.T, parameters.values))
        return Forces(normal, tangential, "N s")
    return Forces(pushed, np.zeros_like(pushed), signals[0].unit if signals else "")


def forces_drawn(forces: Forces | None, contacts: Sequence[Sequence[ContactFrame]]) -> Forces | None:
    """Return the forces shown by arrows (in space only normal forces); None without forces."""
    if forces is None or all(frame.flat for frames in contacts[:1] for frame in frames):
        return forces
    return replace(forces, friction=np.zeros_like(forces.friction))


def arrow_caption(largest: float, unit: str, rough: bool) -> str:
    """Return the caption of force arrows and, if ``rough``, of friction cones."""
    cones = "; shaded: friction cone" if rough else ""
    noun = "impulse" if unit == "N s" else "force"
    return f"arrows: contact {noun}, the longest {largest:.3g} {unit}{cones}"


def acting_contacts(view: RunView) -> tuple[dict[str, np.ndarray], dict[int, str]]:
    """Return two mappings: sizes of contact forces, and names of the acting contacts.

    The first maps a suffix ("" for the plan, or "_replay") to sizes (N, points). The second maps columns of the
    sizes to names, for contacts with a visible force in the plan or in its replay.
    """
    forces_by_suffix = {suffix: forces_of(view, suffix) for suffix in ("", "_replay")}
    sizes = {key: np.hypot(forces.normal, forces.friction) for key, forces in forces_by_suffix.items() if forces}
    if not sizes:
        return {}, {}
    largest_sizes = np.max([np.nanmax(size, axis=0, initial=0.0) for size in sizes.values()], axis=0)
    acting = np.flatnonzero((largest_sizes > LEAST * largest_sizes.max(initial=0.0)) & (largest_sizes > 0))
    names = [signal.name for signal in view.signals("contacts")]
    if "point" in view.run.data.coords and view.run.data.sizes["point"] == largest_sizes.size:
        names = [str(name) for name in view.run.data["point"].values]
    return sizes, {int(i): names[i] for i in acting}


def longest_arrow(size: np.ndarray) -> float:
    """Return the length [m] of the arrow for the largest force in a view of ``size`` (2,)."""
    return min(_ARROW_OF_LONG_SIDE * float(size.max()), _ARROW_OF_SHORT_SIDE * float(size.min()))


def visible_forces(
    contacts: Sequence[ContactFrame], pushes: tuple[np.ndarray, np.ndarray], largest: float
) -> Iterator[tuple[ContactFrame, float, float]]:
    """Yield the contacts whose forces are large enough to draw, with normal and friction force."""
    for frame, normal, friction in zip(contacts, *pushes, strict=False):
        length_in_view = math.hypot(frame.nx, frame.ny)
        if length_in_view * math.hypot(normal, friction) >= LEAST * largest > 0:
            yield frame, float(normal), float(friction)


def draw_contacts(
    axis: Axes,
    contacts: Sequence[ContactFrame],
    pushes: tuple[np.ndarray, np.ndarray],
    largest: float,
    cones: float = 1,
) -> list[Artist]:
    """Draw the forces ``pushes``, normal and friction (points,), and friction cones; return the artists.

    A force of size ``largest`` has the longest arrow (:func:`longest_arrow`); very small forces are not drawn.
    ``cones`` is the opacity of the cones relative to the usual opacity, 0 for no cones.
    """
    longest = longest_arrow(np.ptp([axis.get_xlim(), axis.get_ylim()], axis=1))
    artists = list[Artist]()
    for frame, normal, friction in visible_forces(contacts, pushes, largest):
        if frame.friction and cones:
            artists.append(axis.add_patch(cone_stroke(frame, longest, cones).patch()))
        artists.append(draw_force(axis, frame, normal, friction, longest / largest))
    return artists


def draw_force(axis: Axes, frame: ContactFrame, normal: float, friction: float, scale: float) -> Artist:
    """Draw a force as an arrow from the contact, with the length force times ``scale`` [m per unit]."""
    x, y = frame.force(normal, friction)
    return axis.annotate(
        "",
        xytext=(frame.x, frame.y),
        xy=(frame.x + scale * x, frame.y + scale * y),
        zorder=5,
        annotation_clip=False,
        arrowprops={
            "arrowstyle": "-|>",
            "color": VERMILLION,
            "linewidth": 1.0,
            "shrinkA": 0,
            "shrinkB": 0,
            "mutation_scale": 6,
        },
    )


def cone_stroke(frame: ContactFrame, longest: float, strength: float = 1) -> Stroke:
    """Return the stroke of a friction cone, which spans atan(friction) on either side of the normal.

    ``longest`` is the length [m] of the longest arrow, ``strength`` scales the darkness.
    """
    middle, half_angle = math.atan2(frame.ny, frame.nx), math.atan(frame.friction)
    wedge = Path.wedge(math.degrees(middle - half_angle), math.degrees(middle + half_angle))
    path = Path(np.asarray(wedge.vertices) * (_CONE_ARROWS * longest) + (frame.x, frame.y), wedge.codes)
    return Stroke(path, to_rgba(PURPLE, 0.22 * strength), to_rgba(PURPLE, 0.8 * strength), 0.6, 3)


_FEWEST_INSTANTS = 3
"""Minimum number of instants in a strobe."""
_MOST_INSTANTS = 7
"""Maximum number of instants in a strobe."""
_TALLEST_IN = 3.1
"""Maximum height of a strobe [inch]."""
_ROW_HEIGHT_IN = 1.7
"""Height of a row of strobes before its limits are known [inch]."""
_LETTERS = 120
"""Number of characters of titles that fit in the width of a row of strobes."""
MOST_SCENARIOS = 12
"""Maximum number of scenarios that are drawn."""


def strobe(view: RunView, cones: bool = False) -> Figure | None:
    """Return a strobe of scenario 0, with friction cones if ``cones``; None for a problem without a drawing."""
    if view.picture is None:
        return None
    figure = Figure(figsize=(WIDTH, _TALLEST_IN))
    axis = figure.subplots()
    draw_strobe(axis, view, cones)
    ratio = np.ptp(axis.get_ylim()) / np.ptp(axis.get_xlim())
    figure.set_figheight(float(np.clip(0.9 * WIDTH * ratio + 0.7, 1.3, _TALLEST_IN)))
    return figure


def picked_scenarios(count: int) -> list[int]:
    """Return the indices of the scenarios to draw, evenly spaced among all ``count``."""
    n_picked = min(count, MOST_SCENARIOS)
    return [int(index) for index in np.linspace(0, count - 1, n_picked).round()]


def strobe_rows(titled_views: Sequence[tuple[str, RunView]], cones: bool = False) -> tuple[list[Figure], str]:
    """Return one figure per row of titled strobes, and a caption with the scale of their arrows.

    Each drawing shows scenario 0 of a view; views that cannot be drawn are omitted. Drawings of the same
    problem share the limits of their axes and the scale of their arrows; different problems have
    different limits and scales.
    """
    titled_views = [(title, view) for title, view in titled_views if view.picture is not None]
    if not titled_views:
        return [], ""
    forces = [drawn_forces for _, view in titled_views if (drawn_forces := _forces_drawn(view)) is not None]
    same_problem = len({view.run.meta["problem"] for _, view in titled_views}) == 1
    largest = max((drawn_forces.largest for drawn_forces in forces), default=0.0)
    count = len(titled_views)
    columns = {1: 1, 2: 2, 4: 2}.get(count, 4 if count in (7, 8) or count > 9 else 3)
    figures, used_axes = list[Figure](), list[Axes]()
    for start in range(0, len(titled_views), columns):
        figure = Figure(figsize=(WIDTH, _ROW_HEIGHT_IN))
        axes = figure.subplots(1, columns, squeeze=False)[0]
        for axis, (title, view) in zip(axes, titled_views[start : start + columns], strict=False):
            draw_strobe(axis, view, cones, largest if same_problem else None)
            axis.set_title(fill(title, _LETTERS // columns), loc="left", fontsize=7.5)
            axis.tick_params(labelsize=7)
            axis.set_xlabel(axis.get_xlabel(), fontsize=7)
            axis.set_ylabel("" if same_problem and axis is not axes[0] else axis.get_ylabel(), fontsize=7)
            used_axes.append(axis)
        for axis in axes[len(titled_views) - start :]:
            axis.set_axis_off()
        figures.append(figure)
    if same_problem:
        _one_view(used_axes)
    # The median, so that one tall picture among several problems does not make all rows tall.
    ratio = np.median([np.ptp(axis.get_ylim()) / np.ptp(axis.get_xlim()) for axis in used_axes])
    lines = max(axis.get_title("left").count("\n") for axis in used_axes)
    height = float(np.clip(ratio * 0.85 * WIDTH / columns + 0.55, 1.0, _TALLEST_IN)) + 0.12 * lines
    for figure in figures:
        figure.set_figheight(height)
    if largest <= 0:
        return figures, ""
    arrow_note = "arrows: contact forces, in each picture to its own scale"
    return figures, arrow_caption(largest, forces[0].unit, cones) if same_problem else arrow_note


def _one_view(axes: Sequence[Axes]) -> None:
    """Set the limits of all axes to the smallest range that contains the limits of each."""
    limits = np.array([[axis.get_xlim(), axis.get_ylim()] for axis in axes])
    low, high = limits[..., 0].min(axis=0), limits[..., 1].max(axis=0)
    for axis in axes:
        axis.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))


def draw_strobe(axis: Axes, view: RunView, cones: bool = False, largest: float | None = None) -> None:
    """Draw the strobe of scenario 0 with its forces into existing axes.

    The longest arrow is for a force of size ``largest``, by default the largest force of the run.
    """
    picture = view.picture
    assert picture is not None
    forces = _forces_drawn(view)
    plays = picture.shapes("", view.time)
    chosen = draw_motion(axis, plays, None if forces is None else _strongest(forces))
    if forces is not None:
        scale_force = forces.largest if largest is None else largest
        acting = chosen[chosen > 0]
        for node, frames in zip(acting, picture.contacts("", view.time[acting]), strict=True):
            pushes = forces.normal[node - 1], forces.friction[node - 1]
            draw_contacts(axis, frames, pushes, scale_force, cones=0.5 if cones else 0)
        if scale_force > 0:
            axis.set_title(arrow_caption(scale_force, forces.unit, cones), loc="left", color=INK)
    name_axes(axis, picture.axes)
    axis.set_axisbelow(True)


def _strongest(forces: Forces) -> int | None:
    """Return the node at the end of the step with the largest force, None without forces."""
    size = np.nan_to_num(np.hypot(forces.normal, forces.friction))
    return int(size.max(axis=1).argmax()) + 1 if size.size and size.max() > 0 else None


def draw_motion(axis: Axes, plays: list[list[Shape]], strongest: int | None = None) -> np.ndarray:
    """Draw the shapes at several nodes of a motion, with early shapes faint; return these nodes.

    ``plays`` contains the shapes at every node. If more than two nodes are drawn, one of them is ``strongest``, the
    node with the largest force.
    """
    chosen = _instants(plays)
    if strongest is not None and len(chosen) > 2:
        inner = 1 + int(np.abs(chosen[1:-1] - strongest).argmin())
        if strongest not in chosen:
            chosen[inner] = strongest
    frames = [plays[node] for node in chosen]
    fixed = constant_shapes(frames, [is_opaque(shape) for shape in frames[0]])
    show(axis, [shape for shapes in frames for shape in shapes])
    for shape in fixed:
        draw(shape, axis, 1.0)
    for strength, shapes in zip(np.linspace(0.2, 1, len(frames)), frames, strict=True):
        for shape in shapes:
            if shape not in fixed:
                draw(shape, axis, strength)
    return chosen


def _instants(plays: list[list[Shape]]) -> np.ndarray:
    """Return the nodes of a strobe, evenly spaced; fewer nodes if bodies hardly move."""
    fixed = set.intersection(*(set(shapes) for shapes in plays))
    boxes = np.array([bounds(s for s in shapes if s not in fixed) for shapes in plays])
    count = _FEWEST_INSTANTS
    if np.isfinite(boxes).all():
        path_length = np.abs(np.diff(boxes.mean(axis=1), axis=0)).sum(axis=0)
        size = np.maximum((boxes[:, 1] - boxes[:, 0]).max(axis=0), 1e-9)
        count = int(min(_MOST_INSTANTS, _FEWEST_INSTANTS + 4 * np.max(path_length / size)))
    return np.unique(np.linspace(0, len(plays) - 1, count).round().astype(int))


def _forces_drawn(view: RunView) -> Forces | None:
    """Return the forces to draw; None if the problem has no contact frames or the run has no forces."""
    if view.picture is None or not view.picture.framed:
        return None
    return forces_drawn(forces_of(view), view.picture.contacts("", view.time[:1]))
