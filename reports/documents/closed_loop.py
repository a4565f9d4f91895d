"""Pages of closed loops: one in full, or several side by side."""

from __future__ import annotations

from typing import Any

from reports.documents.common import Page, law_summary, page_header, request_rows, row_figures, setting_rows
from reports.documents.comparison import describe_runs
from reports.drawing.view import RunView
from reports.figures import closed_loop, trajectories
from reports.tables.closed_loop import loop_notes, loop_rows
from reports.tables.console import number

_GRADE_OF_STATUS = {"done": "survives", "warnings": "certified", "stopped": "certified"}
"""Mapping from the status of a closed loop to its grade; any other status has the grade ``failed``."""
_LEADING_KEYS = ("phase", "plant")
"""Settings of a closed loop that the page lists together with its request."""


def loops_page(views: list[RunView]) -> Page:
    """Return content and figures of the page on one closed loop, or on several."""
    content = {
        **page_header(views[0]),
        "law": law_summary(views[0]),
        "hashes": [view.run.meta["hash"] for view in views],
        "grades": [_GRADE_OF_STATUS.get(view.run.meta["status"], "failed") for view in views],
        "verdicts": [view.run.meta["verdict"] for view in views],
    }
    return _single_loop(views[0], content) if len(views) == 1 else _several_loops(views, content)


def _single_loop(view: RunView, content: dict[str, Any]) -> Page:
    meta = view.run.meta
    content |= {
        "labels": [""],
        "heads": [],
        "rows": [],
        "key": loop_rows(meta),
        "request": [
            *([name, str(view.run.record[name])] for name in _LEADING_KEYS),
            *(row for row in request_rows(view.run) if row[0] == "law"),
        ],
        "settings": [row for row in setting_rows(view.run) if row[0] not in _LEADING_KEYS],
        "notes": [*meta["notes"], *loop_notes(meta)],
    }
    candidates = {
        "snapshots": closed_loop.snapshot_figure(view),
        "cost": closed_loop.cost_and_times(view),
        "timeline": closed_loop.contact_timeline(view),
    }
    drawn_figures = {name: figure for name, figure in candidates.items() if figure is not None}
    contacts = [signal.name for signal in view.signals("contacts")]
    return content, drawn_figures | row_figures("motion", trajectories.plan_rows(view, contacts))


def _several_loops(views: list[RunView], content: dict[str, Any]) -> Page:
    names, descriptions, one_problem = describe_runs(views)
    rows: dict[str, list[str]] = {}
    for index, view in enumerate(views):
        for name, text in loop_rows(view.run.meta):
            rows.setdefault(name, ["–"] * len(views))[index] = text
    content |= {
        "title": views[0].title if one_problem else "Comparison of closed loops",
        "labels": [f"{name}: {text}" for name, text in zip(names, descriptions, strict=True)],
        "heads": ["", *names],
        "rows": [[name, *cells] for name, cells in rows.items()],
        "key": [],
        "request": [],
        "settings": [],
        "notes": [_cheapest(views, names)],
    }
    if not one_problem:
        content |= {"equations": [], "typed": [], "parameters": [], "citation": "", "unloaded": ""}
    return content, {"compared": closed_loop.comparison_figure(views, names)}


def _cheapest(views: list[RunView], names: list[str]) -> str:
    """Return a sentence on the run with the lowest mean cost."""
    costs = {name: view.run.meta["cost"] for name, view in zip(names, views, strict=True)}
    known_costs = {name: cost for name, cost in costs.items() if cost is not None}
    if not known_costs:
        return "No seed of any run reached the end."
    best = min(known_costs, key=lambda name: known_costs[name])
    return f"{best} has the lowest mean cost, {number(known_costs[best], 6)}."
