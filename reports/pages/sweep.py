"""The page of a sweep: its axes, and the result at every point."""

from __future__ import annotations

from typing import Any

from matplotlib.figure import Figure

from ocp.store.stored_run import StoredRun
from ocp.sweeps.sweep import rows
from reports.console import number
from reports.figures import sweep as drawn
from reports.pages.described import Page, head, how, law
from reports.sweep_tables import HEADS, MOST, duration, point_rows
from reports.view import RunView


def sweep_page(view: RunView) -> Page:
    """Content and figures of a sweep; swept names are left out of the tables of constants."""
    swept = {axis["name"] for axis in view.run.meta["study"]["axes"]}
    swept |= {name.removeprefix("problem.") for name in swept}
    common = head(view)
    for table in ("parameters", "settings"):
        common[table] = [row for row in common[table] if row[0] not in swept]
    common["how"] = how(view.run, swept)
    content, figures = sweep_content(view.run)
    return {**common, "law": law(view), **content}, figures


def sweep_content(run: StoredRun) -> tuple[dict[str, Any], dict[str, Figure]]:
    """Key numbers, points, failures and figures."""
    meta, axes = run.meta, run.meta["study"]["axes"]
    dims, found = [axis["name"] for axis in axes], rows(run.data)
    figures = drawn.figures(run.data, axes)
    grade = "survives" if meta["survives"] == meta["points"] else "certified"
    names = [f"map-{k + 1}" for k in range(len(figures))]
    content = {
        "grade": grade if meta["success"] else "failed",
        "key": [
            ["points", " × ".join(map(str, meta["study"]["shape"]))],
            ["solved", str(meta["solved"])],
            ["surviving the referee", str(meta["survives"])],
            ["total iterations", str(sum(row["iterations"] for row in found))],
            ["work", duration(sum(row["seconds"] for row in found))],
        ],
        "axes": [[axis["name"], number(axis["values"][0]), number(axis["values"][-1]),
                  str(len(axis["values"])), "equal ratios" if axis["log"] else "equal steps"]
                 for axis in axes],
        "maps": names,
        "caption": drawn.caption(axes),
        "heads": [*dims, *HEADS],
        "points": point_rows(found, dims),
        "more": max(0, len(found) - MOST),
        "failed": [[failure["command"], failure["verdict"].partition("\n")[0]]
                   for failure in meta["study"]["failed"][:MOST]],
    }  # fmt: skip
    return content, dict(zip(names, figures, strict=True))
