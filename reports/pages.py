"""What a report says, as plain values for the templates, and which figures it shows."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from dynamics.laws import LAWS
from ocp.errors import InputError
from ocp.programs.status import Status
from ocp.store.stored_run import StoredRun
from problems import studies
from problems.objectives import named
from problems.parameters import unit_of
from problems.spec import Spec
from problems.studies.study import Study, origin_of
from reports import estimates
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
    stage_rows,
    violation_rows,
)
from reports.curve_tables import event_rows
from reports.figures import comparison, contacts, continuation, estimate
from reports.figures import run as figures_of
from reports.figures.studies import DRAWINGS
from reports.stages import left_out
from reports.strobe import strobe
from reports.sweeps.page import sweep_content
from reports.trained.page import training_content
from reports.view import RunView

_NOT_SETTINGS = (
    "params", "problem", "source", "versions", "citation", "audit_s", "N", "knobs", "sweep",
)  # fmt: skip
Page = tuple[dict[str, Any], dict[str, Figure]]


def solve_page(view: RunView) -> Page:
    """Content and figures of one solved run."""
    stored = view.run
    solved = stored.status is Status.SOLVED
    content = {
        **_head(view),
        "grade": stored.meta["grade"],
        "key": _key_numbers(view),
        "law": _law(view),
        "stages": [[index, knob_title(knob), *cells, note] for index, knob, *cells, _, note in
                   stage_rows(stored.stages)],
        "left_out": left_out(stored.stages),
        "worst": [] if solved else violation_rows(stored.audit),
        "others": [_pairs(other) for other in stored.meta["others"]],
        "contacts": contact_rows(stored.audit),
        "idle": idle_contacts(stored.audit),
        "scenarios": stored.data.sizes["scenario"],
    }  # fmt: skip
    figures: dict[str, Figure | None] = {"trajectories": figures_of.trajectories(view)}
    if view.array("lam") is not None:
        figures["contact"] = figures_of.contact_plane(view)
    figures["friction"] = contacts.friction_forces(view)
    figures["strobe"] = strobe(view)
    if len(stored.stages) > 1:
        figures["homotopy"] = figures_of.homotopy(view)
    if "K" in stored.data:
        figures["gains"] = figures_of.gains(view)
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
        "settings": [_settings(view.run) for view in views],
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
        "grade": curve_grade(meta["points"]) if meta["success"] else "failed",
        "points": rows,
        "events": [list(row) for row in event_rows(meta["events"])],
        "law": _law(view),
        "key": [["iterations in all", str(meta["iterations"])], ["NLPs built",
                str(meta["nlp_builds"])]],
    }  # fmt: skip
    figures = {"path": continuation.curve(view), "states": continuation.states(view)}
    return content, {name: figure for name, figure in figures.items() if figure is not None}


def sweep_page(view: RunView) -> Page:
    """Content and figures of a sweep; what it goes over is no constant of it."""
    swept = {axis["name"] for axis in view.run.meta["study"]["axes"]}
    swept |= {name.removeprefix("problem.") for name in swept}
    head = _head(view)
    for table in ("parameters", "settings"):
        head[table] = [row for row in head[table] if row[0] not in swept]
    content, figures = sweep_content(view.run)
    return {**head, "law": _law(view), **content}, figures


def curve_grade(points: list[dict[str, Any]]) -> str:
    """Colour of a path that was followed to its end: whether every plan on it survives."""
    return "survives" if all(point["survives"] for point in points) else "certified"


def estimate_page(run: StoredRun) -> Page:
    """Content and figure of a stored estimate."""
    meta, swept = run.meta, run.meta["sweep"]
    try:
        spec = named(run.record.get("source") or meta["problem"])
    except InputError:
        spec = None
    rows = meta["estimates"]
    content = {
        **_described(run, spec, run.record["params"]),
        "title": f"Gradient of {meta['problem']}",
        "caption": estimate.caption(run),
        "swept": swept["name"] if swept else "",
        "rows": [estimates.cells(row, bool(swept)) for row in rows],
        "explanations": [] if swept else [f"{r['estimator']}: {r['explanation']}" for r in rows],
    }
    return content, {"estimate": estimate.draw(run)}


def study_page(run: StoredRun) -> Page:
    """Content and figure of a stored study; raises ``InputError`` for an unknown one."""
    study = studies.get(run.meta["problem"])
    described, fields = _described(run, study, run.record["params"]), study.Params.model_fields
    content = {
        **described,
        "title": f"{study.id}: {study.title}",
        "caption": DRAWINGS[study.id].caption,
        "claims": run.meta["claims"],
        "notes": list(study.notes),
        "parameters": [[*row, origin_of(fields[row[0]])] for row in described["parameters"]],
    }
    return content, {"study": DRAWINGS[study.id].draw(run.data)}


def training_page(views: list[RunView]) -> Page:
    """Content and figures of trained policies on one task."""
    content, figures, firsts = training_content(views)
    settings = [_settings(run) for run in firsts]
    shared = [row for row in settings[0] if all(row in rows for rows in settings)]
    own = [[row for row in rows if row not in shared] for rows in settings]
    return {
        **_head(views[0]), "law": _law(views[0]), **content, "settings": shared, "own": own,
    }, figures  # fmt: skip


def _head(view: RunView) -> dict[str, Any]:
    values = view.run.record.get("params", {}) if view.spec is None else view.params.model_dump()
    return {"title": view.title, **_described(view.run, view.spec, values)}


def _described(run: StoredRun, spec: Spec | Study | None, values: dict[str, Any]) -> dict[str, Any]:
    """What every page says of a run: where it is from, what was asked, and what it found."""
    cited = spec.citation if spec else None
    return {
        "hash": run.meta["hash"],
        "verdict": run.meta["verdict"],
        "equations": list(spec.equations) if isinstance(spec, Spec) else [],
        "parameters": _parameters(spec, values),
        "citation": f"{cited.text}. {full_citation(cited.key)}." if cited else "",
        "settings": _settings(run),
        "versions": _pairs(run.meta.get("versions") or {}),
    }


def _parameters(spec: Spec | Study | None, values: dict[str, Any]) -> list[list[str]]:
    """Name, value, unit and meaning of every parameter."""
    if spec is None:
        return [[name, _shown(value), "", ""] for name, value in values.items()]
    units = {name: unit_of(about) for name, about in spec.Params.model_fields.items()}
    return [
        [name, _shown(values[name]), "" if units[name] == "1" else figures_of.powers(units[name]),
         about.description or ""]
        for name, about in spec.Params.model_fields.items() if name in values
    ]  # fmt: skip


def _shown(value: Any) -> str:
    return number(value) if isinstance(value, int | float) else str(value)


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
    start = f"{low:.2g}" if low >= figures_of.FLOOR else f"less than {figures_of.FLOOR:.0e}"
    return f"Near the central path: μ from {start} to {high:.2g} over contacts and steps."


def _settings(run: StoredRun) -> list[list[str]]:
    """Return what was asked, but for what has its own table or line."""
    shown = {key: value for key, value in run.record.items() if key not in _NOT_SETTINGS}
    return _pairs(shown)


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
