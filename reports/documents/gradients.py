"""Page of the report on the gradients of simulators."""

from __future__ import annotations

from ocp.store.stored_run import StoredRun
from reports.documents.common import Page, run_summary
from reports.figures.gradients import gradients_figure
from reports.tables.console import number
from reports.tables.gradients import HEADS, gradient_cells

RIGHT = ("right", "consistent")
"""Verdicts on gradients that can be used as they are."""
CAPTION = (
    "Central differences over the amplitude, with the band of their rounding errors; the simulator's own derivative at"
    " the parameter, and the range of slopes within a hundredth of its size; smoothed gradients at sigma, with"
    " intervals of 95 %; the exact slope. The axis is logarithmic in both signs where slopes are far larger than the"
    " exact slope."
)
"""Caption of the figure."""


def gradients_page(run: StoredRun) -> Page:
    """Return content and figure of the page on the gradients of simulators."""
    meta, record = run.meta, run.record
    rows = meta["worlds"]
    right = sum(row["verdict"] in RIGHT for row in rows)
    grade = "survives" if right == len(rows) else "certified" if right else "failed"
    parameter = meta["parameter"]
    content = run_summary(run, None, {}) | {
        "title": meta["title"],
        "verdict": f"{right} of {len(rows)} gradients {'is' if right == 1 else 'are'} right.\n{meta['verdict']}",
        "grade": grade,
        "request": [
            ["parameter", f"{parameter['name']} = {number(record['theta'][0])} {parameter['unit']}"],
            ["output", f"{meta['output']['name']} [{meta['output']['unit']}]"],
            ["tolerance", number(record["tolerance"])],
            ["samples", str(record["samples"])],
            ["seed", str(record["seed"])],
        ],
        "settings": [],
        "caption": CAPTION,
        "heads": list(HEADS),
        "rows": [gradient_cells(row) for row in rows],
        "world_settings": [
            [
                row["world"],
                ", ".join(f"{name} = {number(value, 4)}" for name, value in row["settings"].items()),
                versions,
            ]
            for row in rows
            if row["status"] == "done" and row["settings"]
            for versions in [", ".join(f"{name} {version}" for name, version in row["versions"].items())]
        ],
    }
    return content, {"gradients": gradients_figure(run)}
