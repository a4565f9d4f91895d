"""The page of trained policies on one task."""

from __future__ import annotations

from reports.pages.described import Page, head, law, law_asked, settings
from reports.trained.page import training_content
from reports.view import RunView


def training_page(views: list[RunView]) -> Page:
    """Content and figures of trained policies on one task."""
    content, figures, firsts = training_content(views)
    asked = [settings(run) for run in firsts]
    shared = [row for row in asked[0] if all(row in rows for rows in asked)]
    own = [[row for row in rows if row not in shared] for rows in asked]
    laws = list(dict.fromkeys(law_asked(run) for run in firsts))
    told = [["law", "; ".join(laws)], ["judged under", "exact"]]
    return {
        **head(views[0]), "law": law(views[0]), **content, "how": told, "settings": shared,
        "own": own,
    }, figures  # fmt: skip
