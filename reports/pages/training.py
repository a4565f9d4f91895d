"""The page of trained policies on one task."""

from __future__ import annotations

from reports.pages.described import Page, head, law, law_text, settings
from reports.trained.page import training_content
from reports.view import RunView


def training_page(views: list[RunView]) -> Page:
    """Content and figures of trained policies on one task."""
    content, figures, firsts = training_content(views)
    each = [settings(run) for run in firsts]
    shared = [row for row in each[0] if all(row in rows for rows in each)]
    own = [[row for row in rows if row not in shared] for rows in each]
    laws = list(dict.fromkeys(law_text(run) for run in firsts))
    laws_used = [["law", "; ".join(laws)], ["evaluated under", "exact"]]
    return {
        **head(views[0]), "law": law(views[0]), **content, "how": laws_used, "settings": shared,
        "own": own,
    }, figures  # fmt: skip
