"""Page of the report on one solve: verdict, numbers, motion, replay, law, contacts and homotopy."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from ocp.programs.solver import Status
from reports.documents.common import Page, as_text, law_summary, numbered_figures, page_header, row_figures
from reports.drawing.notation import label, symbol
from reports.drawing.strobe import picked_scenarios, strobe, strobe_rows
from reports.drawing.view import RunView
from reports.figures import run, trajectories
from reports.tables.console import number, physics_residuals, small, stage_note, stage_rows, stage_title, violation_rows
from reports.tables.contacts import contact_columns, contact_notes
from reports.tables.survival import disturbance_rows, rung_rows

_GAP_STRIP_IN = 0.5
"""Height of the strips that show gaps below contact forces [inch]."""
_START_KEYS = ("start", "route", "status", "cost", "exact_cost", "referee_cost", "iterations", "chosen")
"""Columns of the table of starts."""
_ENDS = 12
"""Number of stages at the beginning and at the end of a shortened table."""


def solve_page(view: RunView, cones: bool = False, signals: str | None = None) -> Page:
    """Return content and figures of the page on one solve; ``cones`` draws friction cones.

    ``signals`` are the names of the signals drawn over time (:func:`reports.figures.trajectories.select_signals`), None
    for all.
    """
    stored, all_tracks = view.run, trajectories.tracks(view)
    is_solved = stored.status is Status.SOLVED
    names = [] if signals is None else trajectories.select_signals(view, signals)
    shown_multipliers = {name for contact in run.contacts_of(view) for name in contact.multipliers}
    heads, rows = contact_columns(stored.audit)
    content = {
        **page_header(view),
        "grade": stored.meta["grade"],
        "key": key_numbers(view),
        "law": law_summary(view),
        "parted": trajectories.replay_differs(all_tracks),
        "apart": small(trajectories.replay_deviation(all_tracks)),
        "undetermined": trajectories.multipliers_undetermined(all_tracks),
        "replayed": any(track.replay is not None for track in all_tracks),
        "zero": [
            name for name in trajectories.idle_multipliers(all_tracks) if name not in shown_multipliers and not names
        ],
        "stages": _stages(view),
        "left_out": stage_note(stored.stages, stored.meta["cost"]),
        "worst": [] if is_solved else violation_rows(stored.audit),
        "starts": [key.replace("_", " ") for key in _starts(view)],
        "others": [[as_text(attempt.get(key)) for key in _starts(view)] for attempt in stored.meta["others"]],
        "searched": "" if stored.route.search is None else str(stored.route.search),
        "ladder": [] if stored.route.ladder is None else rung_rows(stored.route.ladder),
        "disturbed": [] if stored.route.ladder is None else disturbance_rows(stored.route.ladder),
        "contacts": rows,
        "contact_heads": heads,
        "contact_notes": contact_notes(stored.audit),
        "rough": view.array("friction_bound") is not None,
        "scenarios": view.scenarios,
        "gap": label("its gap", view.gap_unit),
        "averaged": view.run.data.sizes.get("contact", 0) > len(view.signals("contacts")),
        "pictured": len(picked_scenarios(view.pictured)),
    }
    figures, content["arrows"] = _motion(view, cones)
    figures |= row_figures("motion", trajectories.plan_rows(view, shown_multipliers, names))
    if run.is_before_path_end(view):
        figures["contact"] = run.contact_plane(view)
    panels, columns = run.rows_of_contacts(view)
    figures |= row_figures("contacts", panels, columns, _GAP_STRIP_IN)
    if len(stored.stages) > 1:
        figures["homotopy"] = run.homotopy_figure(view)
    if len(stored.meta["others"]) > 1:
        figures["candidates"] = run.candidates_figure(view)
    if "K" in stored.data:
        figures["gains"] = run.gains_figure(view)
    return content, {name: figure for name, figure in figures.items() if figure is not None}


def _motion(view: RunView, cones: bool) -> tuple[dict[str, Figure | None], str]:
    """Return the figures of the motion (one strobe, or rows with a strobe per drawn scenario), and their caption."""
    if view.scenarios == 1 or view.picture is None:
        return {"strobe": strobe(view, cones)}, ""
    picked = picked_scenarios(view.pictured)
    rows, arrows = strobe_rows([(f"scenario {i}", view.scenario(i)) for i in picked], cones)
    return {**numbered_figures("strobes", rows)}, arrows


def _stages(view: RunView) -> list[list[str]]:
    """Return the rows of the table of homotopy stages, without the middle of a long table."""
    rows = [
        [index, symbol(stage_title(label)), *cells, note]
        for index, label, *cells, _, note in stage_rows(view.run.stages, view.run.meta["cost"])
    ]
    if len(rows) <= 2 * _ENDS:
        return rows
    gap_row = ["…", f"{len(rows) - 2 * _ENDS} more", *[""] * (len(rows[0]) - 2)]
    return [*rows[:_ENDS], gap_row, *rows[-_ENDS:]]


def _starts(view: RunView) -> list[str]:
    """Return the columns of the table of starts in which at least one start has a value."""
    attempts = view.run.meta["others"]
    return [key for key in _START_KEYS if any(key in attempt for attempt in attempts)]


def key_numbers(view: RunView) -> list[dict[str, Any]]:
    """Return three columns of names and numbers: costs, checks, residuals."""
    meta, audit = view.run.meta, view.run.audit
    certificate, referee = view.run.certificate, view.run.referee
    costs = [["planned, under the law", number(meta["cost"], 7)], ["replayed, exact law", number(audit.exact_cost, 7)]]
    if referee.survives is not None:
        costs.append(["under the referee", number(referee.cost, 7)])
    if np.isfinite(referee.refined_cost):
        costs.append(["referee at h/4", number(referee.refined_cost, 7)])
    costs += [
        ["iterations", str(meta["iterations"])],
        ["active contact steps", str(sum(contact.steps for contact in audit.contacts))],
    ]
    kind = f", {certificate.kind}" if certificate.kind else ""
    checks = [["stationarity", f"{certificate.stationarity}{kind}"], ["KKT residual", small(certificate.kkt_residual)]]
    if certificate.kind:
        checks.append(["biactive pairs", str(certificate.biactive)])
    if certificate.negative_curvature > 0:
        checks.append(["negative curvature", str(certificate.negative_curvature)])
    checks.append(["state error of replay", small(audit.state_gap)])
    if referee.survives is not None:
        checks.append(["state error of referee", small(referee.gap)])
    residuals = [
        ["largest λ gap", small(audit.complementarity)],
        ["largest min(λ, gap)", small(audit.complementarity_min)],
        ["dynamics", small(audit.dynamics_residual)],
        ["constraints", small(audit.constraint_violation)],
        *(
            [label(_SHORT.get(name, name), unit.partition(",")[0]), small(value)]
            for name, value, unit in physics_residuals(audit)
        ),
    ]
    checks.append(["penetration [m]", small(audit.penetration)])
    for name, worst in (("between nodes [m]", referee.between), ("force at distance [m]", referee.force_distance)):
        if worst is not None:
            checks.append([name, small(worst.amount)])
    return [
        {"title": "Cost", "rows": costs},
        {"title": "Checks", "rows": checks},
        {"title": "Residuals", "rows": residuals},
    ]


_SHORT = {
    "friction cone violated by": "friction cone",
    "dissipation below maximum": "dissipation",
    "energy gained in a step": "energy gained",
    "momentum residual": "momentum",
}
"""Mapping from names of the residuals of :func:`reports.tables.console.physics_residuals` to shorter names."""
