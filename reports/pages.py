"""What a report says, as plain values for the templates, and which figures it shows."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from dynamics.laws import LAWS
from ocp.programs.status import Status
from problems import describe
from reports.bibliography import full_citation
from reports.console import (
    books,
    contact_rows,
    distance_rows,
    idle_contacts,
    judged_rows,
    knob_title,
    number,
    small,
)
from reports.curve_tables import event_rows
from reports.figures import comparison, contacts, run
from reports.figures import continuation as curve_figures
from reports.stages import left_out, shown
from reports.strobe import strobe
from reports.view import RunView

Page = tuple[dict[str, Any], dict[str, Figure]]


def solve_page(view: RunView) -> Page:
    """Content and figures of one solved run."""
    stored = view.run
    solved = stored.status is Status.SOLVED
    content = {
        **_head(view),
        "verdict": stored.meta["verdict"],
        "grade": stored.meta["grade"],
        "key": _key_numbers(view),
        "law": _law(view),
        "stages": [
            [
                str(index), knob_title(stage.knob), small(stage.value) if stage.value else "",
                number(stage.cost, 7), small(stage.complementarity), small(stage.residual),
                str(stage.iterations), "" if stage.accepted else "stepped back",
            ]
            for index, stage in shown(stored.stages)
        ],
        "left_out": left_out(stored.stages),
        "worst": [
            [v.name, v.component, str(v.scenario), str(v.step), small(v.amount)]
            for v in ([] if solved else stored.audit.worst)
        ],
        "others": [_pairs(other) for other in stored.meta["others"]],
        "contacts": [list(row) for row in contact_rows(stored.audit)],
        "idle": idle_contacts(stored.audit),
        "scenarios": stored.data.sizes["scenario"],
    }  # fmt: skip
    figures: dict[str, Figure | None] = {"trajectories": run.trajectories(view)}
    if view.signals("contacts"):
        figures["contact"] = run.contact_plane(view)
    figures["friction"] = contacts.friction_forces(view)
    figures["strobe"] = strobe(view)
    if len(stored.stages) > 1:
        figures["homotopy"] = run.homotopy(view)
    if "K" in stored.data:
        figures["gains"] = run.gains(view)
    return content, {name: figure for name, figure in figures.items() if figure is not None}


def comparison_page(views: list[RunView]) -> Page:
    """Content and figures of several solved runs side by side."""
    names = [chr(ord("A") + i) if i < 26 else str(i + 1) for i in range(len(views))]
    one_problem = len({view.run.meta["problem"] for view in views}) == 1
    content = {
        "title": views[0].title if one_problem else "Runs side by side",
        "names": names,
        "hashes": [view.run.meta["hash"] for view in views],
        "verdicts": [view.run.meta["verdict"] for view in views],
        "rows": comparison.rows(views),
        "settings": [_pairs(_settings(view)) for view in views],
        "versions": _pairs(views[0].run.meta.get("versions") or {}),
    }
    figures: dict[str, Figure | None] = {}
    if one_problem:
        figures["costs"] = comparison.costs(views, names)
        figures["overlay"] = comparison.overlay(views, names)
    figures["strobes"] = comparison.strobes(views, names)
    return content, {name: figure for name, figure in figures.items() if figure is not None}


def continuation_page(view: RunView) -> Page:
    """Content and figures of a path over a parameter."""
    meta, points, head = view.run.meta, view.run.meta["points"], _head(view)
    rows = [
        [
            f"{point['value']:.6g}", number(point["cost"], 7), number(point["exact_cost"], 7),
            small(point["complementarity"]), str(point["iterations"]), str(point["status"]),
        ]
        for point in points
    ]  # fmt: skip
    content = {
        **head,
        "settings": [row for row in head["settings"] if row[0] != meta["over"]],
        "over": meta["over"],
        "verdict": meta["verdict"],
        "grade": curve_grade(meta["points"]) if meta["success"] else "failed",
        "points": rows,
        "events": [list(row) for row in event_rows(meta["events"])],
        "law": _law(view),
        "key": [["iterations in all", str(meta["iterations"])], ["NLPs built",
                str(meta["nlp_builds"])]],
    }  # fmt: skip
    figures = {"path": curve_figures.curve(view), "states": curve_figures.states(view)}
    return content, {name: figure for name, figure in figures.items() if figure is not None}


def curve_grade(points: list[dict[str, Any]]) -> str:
    """Colour of a path that was followed to its end: whether every plan on it survives."""
    return "survives" if all(point["survives"] for point in points) else "certified"


def _head(view: RunView) -> dict[str, Any]:
    meta, spec = view.run.meta, view.spec
    return {
        "title": view.title,
        "problem": meta["problem"],
        "hash": meta["hash"],
        "equations": list(spec.equations) if spec else [],
        "parameters": _parameters(view),
        "citation": _citation(view),
        "settings": _pairs(_settings(view)),
        "versions": _pairs(meta.get("versions") or {}),
    }


def _parameters(view: RunView) -> list[list[str]]:
    if view.spec is None:
        values = view.run.record.get("params", {})
        return [[name, number(value), "", ""] for name, value in values.items()]
    rows = []
    for entry in describe(view.spec):
        value = getattr(view.params, entry["name"])
        shown = number(value) if isinstance(value, int | float) else str(value)
        unit = "" if entry["unit"] == "1" else run.powers(entry["unit"])
        rows.append([entry["name"], shown, unit, entry["description"]])
    return rows


def _citation(view: RunView) -> str:
    citation = view.spec.citation if view.spec else None
    return "" if citation is None else f"{citation.text}. {full_citation(citation.key)}."


def _key_numbers(view: RunView) -> list[list[str]]:
    meta, audit = view.run.meta, view.run.audit
    return [
        ["cost under the chosen law", number(meta["cost"], 8)],
        ["cost under the exact law (replayed)", number(audit.exact_cost, 8)],
        *([name or "referee", value if not what or name.startswith("stat") else f"{value} ({what})"]
          for name, value, what in judged_rows(view.run.certificate, view.run.referee)),
        ["complementarity, largest λ·gap", small(audit.complementarity)],
        ["complementarity, largest min(λ, gap)", small(audit.complementarity_min)],
        ["dynamics residual", small(audit.dynamics_residual)],
        ["constraint violation", small(audit.constraint_violation)],
        ["penetration by true signed distance [m]", small(audit.penetration)],
        *([f"{name} [m]", value] for name, value, _ in distance_rows(view.run.referee)),
        ["largest distance of plan and replay, any state", small(audit.state_gap)],
        ["steps and contacts that are active", str(audit.active_steps)],
        *([f"{name} [{unit.partition(',')[0]}]", small(value)] for name, value, unit in
          books(audit)),
        ["iterations", str(meta["iterations"])],
    ]  # fmt: skip


def _law(view: RunView) -> dict[str, Any]:
    name = str(view.run.record.get("contact", ""))
    law = LAWS.get(name)
    return {
        "name": name,
        "summary": law.summary if law else "",
        "place": _place_on_path(view.array("mu")),
    }


def _place_on_path(mu: np.ndarray | None) -> str:
    """Say where on the central path the plan lies."""
    if mu is None or not np.any(np.isfinite(mu)):
        return ""
    low, high = float(np.nanmin(mu)), float(np.nanmax(mu))
    if high == 0:
        return "At the end of the central path: μ = 0, complementarity itself."
    if high - low <= 1e-9 * high:
        return f"On the central path at μ = {high:.3g} in every contact and step."
    start = f"{low:.2g}" if low >= run.FLOOR else f"less than {run.FLOOR:.0e}"
    return f"Near the central path: μ from {start} to {high:.2g} over contacts and steps."


def _settings(view: RunView) -> dict[str, Any]:
    """Return what was asked, but for parameters, which have their own table."""
    hidden = {"params", "problem", "source", "versions", "citation", "audit_s", "N", "knobs"}
    return {key: value for key, value in view.run.record.items() if key not in hidden}


def _pairs(values: dict[str, Any]) -> list[list[str]]:
    rows = []
    for key, value in values.items():
        if isinstance(value, dict):
            group = key.removesuffix("_settings").removesuffix("_options")
            rows += [[f"{group}.{name}", text] for name, text in _pairs(value)]
        elif value is not None and value != []:
            text = number(value, 8) if isinstance(value, float) else str(value)
            rows.append([key.replace("_", " "), text])
    return rows
