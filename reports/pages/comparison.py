"""The page of several solved runs, each labelled by the settings in which it differs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ocp.store.stored_run import StoredRun
from reports.console import value_text
from reports.figures import comparison
from reports.notation import symbol
from reports.pages.described import Page, how, numbered, pairs, row_figures, settings
from reports.strobe import strobe_rows
from reports.view import RunView

_IN_ORDER = ("problem", "contact", "method", "policy", "solver", "strategy")
_GROUPS = ("params", "contact_settings", "policy_settings", "solver_options")
_NOT_COMPARED = ("source", "versions", "citation", "audit_s", "law_parameters", "jit", "learned_at")


def comparison_page(views: list[RunView], cones: bool = False) -> Page:
    """Content and figures of several solved runs, each labelled by its differences."""
    names = [chr(ord("A") + i) if i < 26 else str(i + 1) for i in range(len(views))]
    one_problem = len({view.run.meta["problem"] for view in views}) == 1
    labelled = labels([view.run for view in views])
    titles = [f"{name}: {label}" for name, label in zip(names, labelled, strict=True)]
    requests = [[*how(view.run), *settings(view.run)] for view in views]
    shared = [row for row in requests[0] if all(row in each for each in requests)]
    content = {
        "title": views[0].title if one_problem else "Comparison of runs",
        "names": names,
        "labels": labelled,
        "colors": [comparison.color_of(place) for place in range(len(views))],
        "hashes": [view.run.meta["hash"] for view in views],
        "verdicts": [view.run.meta["verdict"] for view in views],
        "grades": [view.run.meta["grade"] for view in views],
        "rows": comparison.rows(views),
        "how": shared,
        "own": [[row for row in each if row not in shared] for each in requests],
        "differ": comparison.same_instants(views),
        "versions": pairs(views[0].run.meta.get("versions") or {}),
        "zero": [],
    }
    pictures, content["arrows"] = strobe_rows(list(zip(titles, views, strict=True)), cones)
    figures = numbered("strobes", pictures)
    if one_problem:
        figures["costs"] = comparison.costs(views, titles)
        rows, content["zero"] = comparison.overlay_rows(views)
        figures |= row_figures("motion", rows)
    return content, figures


def labels(runs: Sequence[StoredRun]) -> list[str]:
    """A label for each run: the values in which the runs differ, problem and law first.

    A setting of one law, such as mu, labels only the runs with that law. Identical requests are
    labelled by their hashes.
    """
    requests = [_flat(run) for run in runs]
    found = []
    for run, own in zip(runs, requests, strict=True):
        parts = [str(own[key]) for key in _IN_ORDER if key in own and _differs(key, own, requests)]
        parts += [
            f"{symbol(key)} = {value_text(value, 4)}" for key, value in own.items()
            if key not in _IN_ORDER and _differs(key, own, requests)
        ]  # fmt: skip
        found.append(", ".join(parts) or str(run.meta["hash"])[:6])
    if len(set(found)) == len(found):
        return found
    return [
        f"{name}, {str(run.meta['hash'])[:6]}" if found.count(name) > 1 else name
        for name, run in zip(found, runs, strict=True)
    ]


def _flat(run: StoredRun) -> dict[str, Any]:
    """The request of a run, with one name per setting."""
    record = {key: value for key, value in run.record.items() if key not in _NOT_COMPARED}
    found = {
        key: value for key, value in record.items() if key not in _GROUPS and value is not None
    }
    for group in _GROUPS:
        beside = "contact." if group == "contact_settings" else ""
        found |= {beside + name: value for name, value in (record.get(group) or {}).items()}
    return found


def _differs(key: str, own: Mapping[str, Any], requests: Sequence[Mapping[str, Any]]) -> bool:
    """Whether another run has another value; for a setting of a law, a run with that law."""
    others = [other for other in requests if other is not own]
    if key == "strategy" or key.startswith("contact."):
        others = [other for other in others if other.get("contact") == own.get("contact")]
    return any(other.get(key) != own[key] for other in others)
