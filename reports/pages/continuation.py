"""The page of a path over a parameter."""

from __future__ import annotations

from typing import Any

import numpy as np

from reports.console import number, small
from reports.figures import continuation
from reports.figures.run import FLOOR
from reports.notation import symbol
from reports.pages.described import Page, head, how, law, numbered, row_figures
from reports.tables import event_rows
from reports.view import RunView


def continuation_page(view: RunView, cones: bool = False) -> Page:
    """Content and figures of a path over a parameter; friction cones are drawn where ``cones``."""
    meta, points, common = view.run.meta, view.run.meta["points"], head(view)
    over = str(meta["over"])
    rows = [
        [
            f"{point['value']:.6g}", number(point["cost"], 7), number(point["exact_cost"], 7),
            number(point.get("referee_cost"), 7), _SURVIVES[point.get("survives")],
            small(point["complementarity"]), str(point["iterations"]), str(point["status"]),
        ]
        for point in points
    ]  # fmt: skip
    # For a complete path: whether every plan on it survives.
    grade = "survives" if all(point["survives"] for point in points) else "certified"
    content = {
        **common,
        "verdict": common["verdict"].replace(over, symbol(over)),
        "how": _how(view),
        "settings": [row for row in common["settings"] if row[0] != over],
        "parameters": [row for row in common["parameters"] if row[0] != over],
        "over": continuation.parameter_label(view),
        "grade": grade if meta["success"] else "failed",
        "survived": f"{sum(p.get('survives') is True for p in points)} of {len(points)}",
        "points": rows,
        "events": [list(row) for row in event_rows(meta["events"])],
        "law": law(view),
        "floor": _below(points),
        "key": [["total iterations", str(meta["iterations"])], ["NLPs built",
                str(meta["nlp_builds"])]],
    }  # fmt: skip
    pictures, content["arrows"] = continuation.strobes(view, cones)
    figures = {"path": continuation.curve(view), **numbered("strobes", pictures)}
    if drawn := row_figures("motion", continuation.motion_rows(view)):
        figures |= {"motion-00": continuation.key(view), **drawn}
    return content, figures


_SURVIVES = {True: "yes", False: "no", None: "–"}


def _below(points: list[dict[str, Any]]) -> str:
    """A sentence on points with complementarity too small to draw; empty for none."""
    sizes = [point["complementarity"] for point in points]
    count = sum(size is not None and np.isfinite(size) and size <= FLOOR for size in sizes)
    if not count:
        return ""
    which = "every point" if count == len(points) else f"{count} of {len(points)} points"
    return f"At {which} λ gap is below {FLOOR:.0e} and not drawn."


def _how(view: RunView) -> list[list[str]]:
    meta = view.run.meta
    name, unit = symbol(str(meta["over"])), continuation.parameter_label(view).partition(" ")[2]
    text = f"{number(meta['from'], 4)} to {number(meta['to'], 4)} {unit.strip('[]')}".strip()
    swept = [name, f"{text}, {meta['scale']}, {len(meta['points'])} points"]
    return [swept, *how(view.run, [str(meta["over"])])]
