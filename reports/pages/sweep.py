"""The page of a sweep: what it goes over, and what was found at every point."""

from __future__ import annotations

from reports.pages.described import Page, head, how, law
from reports.sweeps.page import sweep_content
from reports.view import RunView


def sweep_page(view: RunView) -> Page:
    """Content and figures of a sweep; what it goes over is no constant of it."""
    swept = {axis["name"] for axis in view.run.meta["study"]["axes"]}
    swept |= {name.removeprefix("problem.") for name in swept}
    told = head(view)
    for table in ("parameters", "settings"):
        told[table] = [row for row in told[table] if row[0] not in swept]
    told["how"] = how(view.run, swept)
    content, figures = sweep_content(view.run)
    return {**told, "law": law(view), **content}, figures
