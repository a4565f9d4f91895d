"""A page of HTML that plays an animation: its data and a script of ours, nothing from elsewhere.

The data are shapes in metres, forces and curves, drawn on canvases by ``page/player.js``: a film
of 51 frames takes tens of kilobytes, and is as sharp on every screen.
"""

from __future__ import annotations

import html
import json
import math
from dataclasses import fields
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from problems.drawing import ContactFrame, Shape
from reports import shapes
from reports.camera import Camera
from reports.forces import caption
from reports.motion.animation import Animation, Motion
from reports.motion.charts import charts
from reports.motion.scene import LEAST, longest_arrow
from reports.style import PURPLE, VERMILLION

_PAGE = Path(__file__).with_name("page")
_DIGITS = 5
"""Of what is seen at once: a hundred-thousandth of the view is far below a pixel."""
_SIGNIFICANT = 7


def player(animation: Animation) -> str:
    """The whole page."""
    told = animation.view.run.meta.get("verdict") or ""
    film = json.dumps(film_of(animation), ensure_ascii=False, allow_nan=False,
                      separators=(",", ":"))  # fmt: skip
    parts = {name: (_PAGE / f"player.{name}").read_text("utf-8") for name in ("html", "css", "js")}
    return Template(parts["html"]).substitute(
        title=html.escape(animation.title),
        verdict=html.escape(told.splitlines()[0] if told else ""),
        style=parts["css"].strip(),
        script=parts["js"].strip(),
        # No name may end the element that holds the data, or begin one.
        film=film.replace("<", "\\u003c"),
    )


def film_of(animation: Animation) -> dict[str, Any]:
    """What the page's script draws, as plain data.

    ``motions`` hold per frame the shapes ``[kind, numbers...]``, an index into ``kinds`` (name and
    role) and the fields of :mod:`problems.drawing` in their order without the role, and the
    ``arrows`` ``[x, y, force x, force y, normal x, normal y, friction]``; ``charts`` are those of
    :func:`~reports.motion.charts.charts` over ``nodes`` [s].
    """
    size = animation.cameras[0].size
    digits = max(0, _DIGITS - math.floor(math.log10(float(size.max()))))
    kinds: dict[tuple[str, str], int] = {}
    motions = [
        _motion(motion, camera, animation.largest, kinds, digits)
        for motion, camera in zip(animation.motions, animation.cameras, strict=True)
    ]
    wide = size[1] / size[0] < 0.4
    largest = animation.largest
    colors = {role: shapes.color(role) for _, role in kinds}
    return {
        "axes": animation.axes,
        "fps": animation.fps,
        "pace": "" if animation.speed == 1 else f" · {animation.speed:g} × real time",
        "times": [_short(time) for time in animation.times],
        "nodes": [_short(time) for time in animation.view.time],
        "columns": 1 if wide else len(motions),
        "size": [_short(side) for side in size],
        "kinds": list(kinds),
        "coils": shapes.COILS,
        "coil": shapes.COIL,
        "colors": {**colors, "force": VERMILLION, "cone": PURPLE},
        "cones": animation.rough,
        "largest": largest,
        "longest": longest_arrow(size),
        "caption": caption(largest, animation.unit, animation.rough) if largest > 0 else "",
        "motions": motions,
        "charts": [
            {**chart, "curves": [_curve(**curve) for curve in chart["curves"]]}
            for chart in charts(animation)
        ],
    }


def _curve(values: np.ndarray, end: float | None = None, **look: Any) -> dict[str, Any]:
    shown = {**look, "values": [_short(value) for value in values]}
    return shown if end is None else {**shown, "end": _short(end)}


def _motion(
    motion: Motion, camera: Camera, largest: float, kinds: dict[tuple[str, str], int], digits: int
) -> dict[str, Any]:
    frames = [[_numbers(shape, kinds, digits) for shape in frame] for frame in motion.shapes]
    fixed = [shape for shape in frames[0] if all(shape in frame for frame in frames)]
    still = not np.ptp(camera.middle, axis=0).any()
    return {
        "title": motion.title,
        "middle": np.round(camera.middle[:1] if still else camera.middle, digits).tolist(),
        "fixed": fixed,
        "frames": [[shape for shape in frame if shape not in fixed] for frame in frames],
        "arrows": [_arrows(motion, frame, largest, digits) for frame in range(len(frames))],
    }


def _numbers(shape: Shape, kinds: dict[tuple[str, str], int], digits: int) -> list[float]:
    kind = kinds.setdefault((type(shape).__name__, shape.role), len(kinds))
    values = [getattr(shape, part.name) for part in fields(shape) if part.name != "role"]
    return [kind, *(round(float(value), digits) for value in values)]


def _arrows(motion: Motion, frame: int, largest: float, digits: int) -> list[list[float | None]]:
    forces = motion.forces
    if forces is None or not largest > 0:
        return []
    pushes = zip(motion.contacts[frame], forces.normal[frame], forces.friction[frame], strict=False)
    return [
        _arrow(contact, float(normal), float(friction), digits)
        for contact, normal, friction in pushes if math.hypot(normal, friction) >= LEAST * largest
    ]  # fmt: skip


def _arrow(
    contact: ContactFrame, normal: float, friction: float, digits: int
) -> list[float | None]:
    tx, ty = contact.tangent
    force = normal * contact.nx + friction * tx, normal * contact.ny + friction * ty
    shown = (*force, contact.nx, contact.ny, contact.friction)
    place = round(contact.x, digits), round(contact.y, digits)
    return [*place, *(_short(value) for value in shown)]


def _short(value: float) -> float | None:
    """Seven significant digits, and None for what is no number."""
    return float(f"{value:.{_SIGNIFICANT}g}") if math.isfinite(value) else None
