"""The page of several solved runs side by side."""

from __future__ import annotations

from reports.figures import comparison
from reports.pages.described import Page, how, numbered, pairs, row_figures, settings
from reports.pages.labels import labels
from reports.view import RunView


def comparison_page(views: list[RunView], cones: bool = False) -> Page:
    """Content and figures of several solved runs side by side, each named by what differs."""
    names = [chr(ord("A") + i) if i < 26 else str(i + 1) for i in range(len(views))]
    one_problem = len({view.run.meta["problem"] for view in views}) == 1
    told = labels([view.run for view in views])
    titles = [f"{name}: {label}" for name, label in zip(names, told, strict=True)]
    asked = [[*how(view.run), *settings(view.run)] for view in views]
    shared = [row for row in asked[0] if all(row in each for each in asked)]
    content = {
        "title": views[0].title if one_problem else "Runs side by side",
        "names": names,
        "labels": told,
        "colors": [comparison.color_of(place) for place in range(len(views))],
        "hashes": [view.run.meta["hash"] for view in views],
        "verdicts": [view.run.meta["verdict"] for view in views],
        "grades": [view.run.meta["grade"] for view in views],
        "rows": comparison.rows(views),
        "how": shared,
        "own": [[row for row in each if row not in shared] for each in asked],
        "differ": comparison.same_instants(views),
        "versions": pairs(views[0].run.meta.get("versions") or {}),
        "zero": [],
    }
    pictures, content["arrows"] = comparison.strobes(views, titles, cones)
    figures = numbered("strobes", pictures)
    if one_problem:
        figures["costs"] = comparison.costs(views, titles)
        rows, content["zero"] = comparison.overlay_rows(views)
        figures |= row_figures("motion", rows)
    return content, figures
