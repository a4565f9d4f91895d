"""Tables of remedies for a plan that does not survive, and of disturbances that the solution survives."""

from __future__ import annotations

from rich.table import Table

from ocp.judge.route_report import Ladder
from reports.tables.console import number, table_of

RUNG_HEADS = ("remedy", ">N", ">its plan", ">at h", ">at h/4", "survives", "note")
"""Headings of the columns of the table of remedies."""
DISTURBANCE_HEADS = ("disturbance", ">survives", ">median cost", ">largest cost")
"""Headings of the columns of the table of disturbances."""


def rung_rows(ladder: Ladder) -> list[list[str]]:
    """Return a row for every remedy."""
    rows = []
    for rung in ladder.rungs:
        if rung.survives is None:
            rows.append([rung.name, "", "", "", "", "not tried", rung.note])
            continue
        costs = [number(cost, 6) for cost in (rung.planned, rung.cost, rung.refined_cost)]
        status = "" if rung.status == "solved" else rung.status
        note = "; ".join(filter(None, [status, rung.note]))
        rows.append([rung.name, str(rung.N), *costs, "yes" if rung.survives else "no", note])
    return rows


def disturbance_rows(ladder: Ladder) -> list[list[str]]:
    """Return a row for every disturbance of the solution."""
    return [
        [row.disturbance, f"{row.survived} of {row.draws}", number(row.median_cost, 6), number(row.largest_cost, 6)]
        for row in ladder.disturbed
    ]


def ladder_table(ladder: Ladder) -> Table:
    """Return the table of remedies, one row for each rung of the ladder."""
    return table_of(*RUNG_HEADS, rows=rung_rows(ladder), title="until it survives")


def disturbance_table(ladder: Ladder) -> Table:
    """Return the table of disturbances, with the number of draws that the solution survives."""
    return table_of(*DISTURBANCE_HEADS, rows=disturbance_rows(ladder), title="what it survives")
