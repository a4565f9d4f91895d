"""HTML page that plays an animation, with its data and a script, and without other resources."""

from __future__ import annotations

import html
import json
import math
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from ocp.problem.evaluation import Evaluation, at_steps
from ocp.problem.task import Task
from problems.drawing import Shape
from reports.drawing import shapes
from reports.drawing.notation import label
from reports.drawing.shapes import Camera
from reports.drawing.strobe import acting_contacts, arrow_caption, longest_arrow, visible_forces
from reports.drawing.style import CYCLE, PLANNED, PURPLE, REPLAYED, VERMILLION
from reports.drawing.view import RunView
from reports.motion.animation import Animation, Motion

_PAGE_FOLDER = Path(__file__).with_name("page")
"""Folder of the page's HTML, CSS and JavaScript."""
_DIGITS = 5
"""Number of digits of positions relative to the size of the view; more digits are far below a pixel."""
_SIGNIFICANT_DIGITS = 7
"""Number of significant digits of numbers on the page."""


def player_page(animation: Animation) -> str:
    """Return the HTML page that plays an animation."""
    verdict = animation.view.run.meta.get("verdict") or ""
    film = json.dumps(player_data(animation), ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    sources = {name: (_PAGE_FOLDER / f"player.{name}").read_text("utf-8") for name in ("html", "css", "js")}
    return Template(sources["html"]).substitute(
        title=html.escape(animation.title),
        verdict=html.escape(verdict.splitlines()[0] if verdict else ""),
        style=sources["css"].strip(),
        script=sources["js"].strip(),
        # No name in the data may end the HTML element that contains the data, or begin another element.
        film=film.replace("<", "\\u003c"),
    )


def player_data(animation: Animation) -> dict[str, Any]:
    """Return the data that the page's script draws.

    Each frame in ``motions`` has lists of shapes and arrows. A shape is ``[kind, numbers...]``: the index of its name
    and role in ``kinds``, and its fields in :mod:`problems.drawing` except the role, with all corners in one list
    ``x, y, ...``. An arrow is ``[x, y, force x, force y, normal x, normal y, friction]``. ``charts`` are the charts
    of :func:`~reports.motion.player.player_charts` over ``nodes`` [s].
    """
    size = animation.cameras[0].size
    digits = max(0, _DIGITS - math.floor(math.log10(float(size.max()))))
    kinds: dict[tuple[str, str], int] = {}
    motions = [
        _motion(motion, camera, animation.largest, kinds, digits)
        for motion, camera in zip(animation.motions, animation.cameras, strict=True)
    ]
    largest = animation.largest
    colors = {role: shapes.color(role) for _, role in kinds}
    return {
        "axes": animation.axes,
        "fps": animation.fps,
        "pace": "" if animation.speed == 1 else f" · {animation.speed:g} × real time",
        "times": [_short(time) for time in animation.times],
        "nodes": [_short(time) for time in animation.view.time],
        "columns": 1 if animation.cameras[0].is_wide else len(motions),
        "size": [_short(side) for side in size],
        "kinds": list(kinds),
        "coils": shapes.COIL_COUNT,
        "coil": shapes.COIL_HALF_WIDTH_M,
        "colors": {**colors, "force": VERMILLION, "cone": PURPLE},
        "cones": animation.rough,
        "largest": largest,
        "longest": longest_arrow(size),
        "caption": arrow_caption(largest, animation.unit, animation.rough) if largest > 0 else "",
        "motions": motions,
        "charts": [
            {**chart, "curves": [_curve(**curve) for curve in chart["curves"]]} for chart in player_charts(animation)
        ],
    }


def _curve(values: np.ndarray, end: float | None = None, **style: Any) -> dict[str, Any]:
    entry = {**style, "values": [_short(value) for value in values]}
    return entry if end is None else {**entry, "end": _short(end)}


def _motion(
    motion: Motion, camera: Camera, largest: float, kinds: dict[tuple[str, str], int], digits: int
) -> dict[str, Any]:
    frames = [[_numbers(shape, kinds, digits) for shape in frame] for frame in motion.shapes]
    fixed = shapes.constant_shapes(frames, [shapes.is_opaque(shape) for shape in motion.shapes[0]])
    drawn_once = set(fixed)
    is_still = not np.ptp(camera.middle, axis=0).any()
    return {
        "title": motion.title,
        "middle": np.round(camera.middle[:1] if is_still else camera.middle, digits).tolist(),
        "fixed": [[*numbers] for numbers in fixed],
        "frames": [[[*numbers] for numbers in frame if numbers not in drawn_once] for frame in frames],
        "arrows": [_arrows(motion, frame, largest, digits) for frame in range(len(frames))],
    }


def _numbers(shape: Shape, kinds: dict[tuple[str, str], int], digits: int) -> tuple[Any, ...]:
    kind = kinds.setdefault((type(shape).__name__, shape.role), len(kinds))
    values = (getattr(shape, field.name) for field in fields(shape) if field.name != "role")
    return kind, *(_rounded(value, digits) for value in values)


def _rounded(value: Any, digits: int) -> Any:
    """Return a rounded number or, for corners, their rounded coordinates in one tuple."""
    if isinstance(value, tuple):
        return tuple(round(float(coordinate), digits) for corner in value for coordinate in corner)
    return round(float(value), digits)


def _arrows(motion: Motion, frame: int, largest: float, digits: int) -> list[list[float | None]]:
    forces = motion.forces
    if forces is None:
        return []
    pushes, arrows = (forces.normal[frame], forces.friction[frame]), []
    for contact, normal, friction in visible_forces(motion.contacts[frame], pushes, largest):
        numbers = (*contact.force(normal, friction), contact.nx, contact.ny, contact.friction)
        position = round(contact.x, digits), round(contact.y, digits)
        arrows.append([*position, *(_short(value) for value in numbers)])
    return arrows


def _short(value: float) -> float | None:
    """Return a number with seven significant digits; None for NaN and infinity."""
    return float(f"{value:.{_SIGNIFICANT_DIGITS}g}") if math.isfinite(value) else None


_CHART_ROOM = 0.06
"""Space above and below curves, as a fraction of their range."""

Chart = dict[str, Any]
"""Chart with ``title``, ``label``, ``range`` [low, high], ``wide``, and ``curves``.

A curve has ``name``, ``values``, ``color`` and ``dash``. Its values belong to the nodes (N+1,), or to the steps
between them (N,); a curve of costs also has ``end``, the total cost.
"""


def player_charts(animation: Animation) -> list[Chart]:
    """Return charts of the forces of each motion, all on the same scale, and a chart of the motions' costs."""
    view = animation.view
    all_charts = [forces for motion in animation.motions if (forces := _forces(view, motion))]
    curve_values = [curve["values"] for chart in all_charts for curve in chart["curves"]]
    highest = max((float(np.nanmax(values)) for values in curve_values), default=0.0)
    for chart in all_charts:
        chart["range"] = _widened(0.0, highest)
    if (cost_chart := _costs(view, animation.motions)) is not None:
        all_charts.append(cost_chart)
    return all_charts


def _forces(view: RunView, motion: Motion) -> Chart | None:
    """Return a chart of a motion's forces, for contacts that act in plan or replay; None without such contacts."""
    sizes, acting = acting_contacts(view)
    force_sizes, forces = sizes.get(motion.suffix), motion.forces
    if force_sizes is None or forces is None or not acting:
        return None
    noun = "impulse" if forces.unit == "N s" else "force"
    simulated = isinstance(view.problem, Task) or view.run.kind == "closed-loop"
    qualifier = "" if simulated else ", planned"
    return {
        "title": f"contact {noun}s{', replayed' if motion.suffix else qualifier}",
        "label": label(noun, forces.unit),
        "wide": False,
        "curves": [
            {
                "name": name,
                "values": force_sizes[:, i],
                "color": CYCLE[index % len(CYCLE)],
                "dash": index // len(CYCLE) % 3,
            }
            for index, (i, name) in enumerate(acting.items())
        ],
    }


def _costs(view: RunView, motions: Sequence[Motion]) -> Chart | None:
    curves = []
    for motion, name, color in zip(motions, ("planned", "replayed"), (PLANNED, REPLAYED), strict=False):
        sums_and_end = cumulative_cost(view, motion.suffix)
        if sums_and_end is None:
            return None
        curves.append({"name": name, "values": sums_and_end[0], "end": sums_and_end[1], "color": color, "dash": 0})
    is_task = isinstance(view.problem, Task)
    if view.run.kind == "closed-loop":
        curves[0]["name"] = "closed loop"
    if is_task:
        curves[0]["name"] = "this episode"
    ends = [curve["end"] for curve in curves]
    finite = np.concatenate([*(curve["values"] for curve in curves), ends])
    finite = finite[np.isfinite(finite)]
    noun, last = ("return", "the final reward") if is_task else ("cost", "the terminal cost")
    return {
        "title": f"cumulative {noun}, with {last} at the end",
        "label": noun,
        "wide": True,
        "range": _widened(float(finite.min()), float(finite.max())),
        "curves": curves,
    }


def cumulative_cost(view: RunView, suffix: str) -> tuple[np.ndarray, float] | None:
    """Return the sum of stage costs before each node (N+1,), and the total with the terminal cost.

    The costs are those of scenario 0 at the stored parameters. For a task they are rewards, and the total
    includes the final reward only after a full episode. Returns None for an unknown problem, and if the run lacks
    arrays that the cost depends on.
    """
    problem, x, u = view.problem, view.array(f"x{suffix}"), view.array(f"u{suffix}")
    if view.run.kind == "closed-loop":
        stage_costs, terminal_cost = (view.run.data[name].values[0] for name in ("cost", "end_cost"))
        sums = np.concatenate([[0.0], np.cumsum(stage_costs)])
        return sums, float(sums[-1] + terminal_cost)
    if problem is None or x is None or u is None:
        return None
    p = problem.parameters.values
    if isinstance(problem, Task):
        (stage,) = at_steps(problem.rewards, x[:1, :-1], u[:1], x[:1, 1:], p=p)
        is_full_episode = u.shape[1] == problem.horizon
        last = np.array(problem.finals(x[0, -1], p)) if is_full_episode else np.zeros(1)
    else:
        lam = view.array(f"lam{suffix}") if problem.uses_impulses else np.zeros((*u.shape[:2], problem.system.nlam))
        if lam is None or lam.shape[-1] != problem.system.nlam:
            return None
        stage, last = Evaluation(problem, problem.parameters.defaults).cost_parts(x[:1], u[:1], lam[:1])
    sums = np.concatenate([[0.0], np.cumsum(stage[0, :, 0])])
    return sums, float(sums[-1] + last.item())


def _widened(low: float, high: float) -> list[float]:
    """Return a range around low, high and zero, with space above and (for negative values) below; never empty."""
    low, high = min(low, 0.0), max(high, 0.0)
    room = _CHART_ROOM * (high - low) or 0.5
    return [low - room if low < 0 else 0.0, high + room]
