"""Pages of several solves, each labelled by its differences, and of a path of solutions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ocp.store.stored_run import StoredRun
from reports.documents.common import (
    Page,
    law_summary,
    numbered_figures,
    page_header,
    request_rows,
    row_figures,
    setting_rows,
    text_rows,
)
from reports.drawing.notation import symbol
from reports.drawing.strobe import strobe_rows
from reports.drawing.style import line_of
from reports.drawing.view import RunView
from reports.figures import comparison
from reports.figures.run import FLOOR
from reports.tables.console import number, small, value_text
from reports.tables.listings import event_rows

_LABEL_KEYS = ("problem", "contact", "method", "policy", "solver", "strategy")
"""First keys of a request in labels, in this order."""
_SETTING_GROUPS = ("params", "contact_settings", "policy_settings", "solver_options")
"""Keys of a request whose values are dictionaries of settings."""
_NOT_COMPARED = ("source", "versions", "citation", "audit_s", "law_parameters", "jit", "learned_at", "certify", "rate")
"""Keys of a run's record that labels do not contain."""


def comparison_page(views: list[RunView], cones: bool = False) -> Page:
    """Return content and figures of the page on several solves, each labelled by its differences."""
    names, labelled, one_problem = describe_runs(views)
    titles = [f"{name}: {label}" for name, label in zip(names, labelled, strict=True)]
    requests = [[*request_rows(view.run), *setting_rows(view.run)] for view in views]
    shared = [row for row in requests[0] if all(row in request for request in requests)]
    content = {
        "title": views[0].title if one_problem else "Comparison of runs",
        "names": names,
        "labels": labelled,
        "colors": [line_of(index)["color"] for index in range(len(views))],
        "hashes": [view.run.meta["hash"] for view in views],
        "verdicts": [view.run.meta["verdict"] for view in views],
        "grades": [view.run.meta["grade"] for view in views],
        "rows": comparison.comparison_rows(views),
        "request": shared,
        "own_settings": [[row for row in request if row not in shared] for request in requests],
        "differ": comparison.same_instants(views),
        "versions": text_rows(views[0].run.meta.get("versions") or {}),
        "zero": [],
    }
    pictures, content["arrows"] = strobe_rows(list(zip(titles, views, strict=True)), cones)
    figures = numbered_figures("strobes", pictures)
    if one_problem:
        figures["costs"] = comparison.cost_figure(views, titles)
        rows, content["zero"] = comparison.overlay_rows(views)
        figures |= row_figures("motion", rows)
    return content, figures


def describe_runs(views: Sequence[RunView]) -> tuple[list[str], list[str], bool]:
    """Return letters and labels of several runs, and whether all runs solve the same problem."""
    letters = [chr(ord("A") + i) if i < 26 else str(i + 1) for i in range(len(views))]
    one_problem = len({view.run.meta["problem"] for view in views}) == 1
    return letters, run_labels([view.run for view in views]), one_problem


def run_labels(runs: Sequence[StoredRun]) -> list[str]:
    """Return a label for each run: the values in which the runs differ, problem and law first.

    Runs of different problems are labelled by problem and law, and by further values only if another run has
    the same problem and law. A setting of one law, such as mu, labels only the runs with that law. Identical
    requests are labelled by their hashes.
    """
    all_requests = [_flat(run) for run in runs]
    leading_keys = _LABEL_KEYS[:2] if len({request.get("problem") for request in all_requests}) > 1 else ()
    leading_words = [[str(request[key]) for key in leading_keys if key in request] for request in all_requests]
    all_labels = []
    for run, request, label_parts in zip(runs, all_requests, leading_words, strict=True):
        requests = [
            candidate
            for candidate, compared in zip(all_requests, leading_words, strict=True)
            if compared == label_parts
        ]
        differing = [key for key in request if _differs(key, request, requests)]
        label_parts = label_parts + [str(request[key]) for key in _LABEL_KEYS if key in differing]
        label_parts += [f"{symbol(key)} = {value_text(request[key], 4)}" for key in differing if key not in _LABEL_KEYS]
        all_labels.append(", ".join(label_parts) or str(run.meta["hash"])[:6])
    if len(set(all_labels)) == len(all_labels):
        return all_labels
    return [
        f"{name}, {str(run.meta['hash'])[:6]}" if all_labels.count(name) > 1 else name
        for name, run in zip(all_labels, runs, strict=True)
    ]


def _flat(run: StoredRun) -> dict[str, Any]:
    """Return the request of a run as a flat dictionary, with one key per setting."""
    record = {key: value for key, value in run.record.items() if key not in _NOT_COMPARED}
    flat_request = {key: value for key, value in record.items() if key not in _SETTING_GROUPS and value is not None}
    for group in _SETTING_GROUPS:
        prefix = "contact." if group == "contact_settings" else ""
        flat_request |= {prefix + name: value for name, value in (record.get(group) or {}).items()}
    return flat_request


def _differs(key: str, request: Mapping[str, Any], requests: Sequence[Mapping[str, Any]]) -> bool:
    """Return whether a request with the same law (any request, unless ``key`` is a law setting) has another value."""
    compared_requests = [compared for compared in requests if compared is not request]
    if key == "strategy" or key.startswith("contact."):
        compared_requests = [
            compared for compared in compared_requests if compared.get("contact") == request.get("contact")
        ]
    return any(compared.get(key) != request[key] for compared in compared_requests)


def continuation_page(view: RunView, cones: bool = False) -> Page:
    """Return content and figures of the page on a path of solutions; ``cones`` draws friction cones."""
    meta, points, common = view.run.meta, view.run.meta["points"], page_header(view)
    swept_name = str(meta["over"])
    rows = [
        [
            f"{point['value']:.6g}",
            number(point["cost"], 7),
            number(point["exact_cost"], 7),
            number(point.get("referee_cost"), 7),
            _SURVIVAL_TEXT[point.get("survives")],
            small(point["complementarity"]),
            str(point["iterations"]),
            str(point["status"]),
        ]
        for point in points
    ]
    # A complete path survives if every plan on it does.
    grade = "survives" if all(point["survives"] for point in points) else "certified"
    content = {
        **common,
        "verdict": common["verdict"].replace(swept_name, symbol(swept_name)),
        "request": _continuation_request(view),
        "settings": [row for row in common["settings"] if row[0] != swept_name],
        "parameters": [row for row in common["parameters"] if row[0] != swept_name],
        "over": comparison.parameter_label(view),
        "grade": grade if meta["success"] else "failed",
        "survived": f"{sum(p.get('survives') is True for p in points)} of {len(points)}",
        "points": rows,
        "events": [list(row) for row in event_rows(meta["events"])],
        "law": law_summary(view),
        "floor": _below(points),
        "key": [["total iterations", str(meta["iterations"])], ["NLPs built", str(meta["nlp_builds"])]],
    }
    pictures, content["arrows"] = comparison.strobe_figures(view, cones)
    figures = {"path": comparison.curve_figure(view), **numbered_figures("strobes", pictures)}
    if motion_figures := row_figures("motion", comparison.motion_rows(view)):
        figures |= {"motion-00": comparison.point_key(view), **motion_figures}
    return content, figures


_SURVIVAL_TEXT = {True: "yes", False: "no", None: "–"}
"""Mapping from whether a plan survives, None if unknown, to its text."""


def _below(points: list[dict[str, Any]]) -> str:
    """Return a sentence on points whose complementarity is too small to draw; "" if there are none."""
    sizes = [point["complementarity"] for point in points]
    count = sum(size is not None and np.isfinite(size) and size <= FLOOR for size in sizes)
    if not count:
        return ""
    places_text = "every point" if count == len(points) else f"{count} of {len(points)} points"
    return f"At {places_text} λ gap is below {FLOOR:.0e} and not drawn."


def _continuation_request(view: RunView) -> list[list[str]]:
    meta = view.run.meta
    name, unit = symbol(str(meta["over"])), comparison.parameter_label(view).partition(" ")[2]
    text = f"{number(meta['from'], 4)} to {number(meta['to'], 4)} {unit.strip('[]')}".strip()
    swept = [name, f"{text}, {meta['scale']}, {len(meta['points'])} points"]
    return [swept, *request_rows(view.run, [str(meta["over"])])]
