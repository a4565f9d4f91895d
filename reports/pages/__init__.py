"""What each kind of report says, as plain values for the templates, and which figures it shows."""

from reports.pages.comparison import comparison_page
from reports.pages.continuation import continuation_page
from reports.pages.described import Page
from reports.pages.estimate import estimate_page
from reports.pages.solve import solve_page
from reports.pages.study import study_page
from reports.pages.sweep import sweep_page
from reports.pages.training import training_page

__all__ = [
    "Page", "comparison_page", "continuation_page", "estimate_page", "solve_page", "study_page",
    "sweep_page", "training_page",
]  # fmt: skip
