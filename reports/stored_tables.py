"""What is known and what is stored: parameters, best known values, runs, claims."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from rich.table import Table
from rich.text import Text

from reports.console import number, table_of

if TYPE_CHECKING:
    from ocp.store.stored_run import StoredRun
    from problems.spec import Golden
    from problems.studies import Claim


def parameter_table(parameters: Sequence[Mapping[str, Any]]) -> Table:
    """A problem's parameters with default, unit and meaning."""
    table = table_of(("parameter", "left"), ("default", "right"), ("unit", "left"), ("", "left"))
    for row in parameters:
        value, meaning = row["value"], row["description"]
        if isinstance(value, str):
            table.add_row(row["name"], value, "", f"{meaning} ({row['range']})")
            continue
        shown = number(value) if isinstance(value, int | float) else "required"
        table.add_row(row["name"], shown, row["unit"], meaning)
    return table


def golden_table(golden: Mapping[str, Golden]) -> Table:
    """Best known values, their certificates, and of how many solves each is the best."""
    rows = (
        (name, known.method, number(known.cost, 9), known.certificate, str(known.tried))
        for name, known in golden.items()
    )
    return table_of(
        ("best known", "left"), ("method", "left"), ("cost", "right"), ("certificate", "left"),
        ("of solves", "right"), rows=rows,
    )  # fmt: skip


def run_table(run: StoredRun) -> Table:
    """What one run's description says, one line a key."""
    table = table_of(("", "left"), ("", "left"))
    table.show_header = False
    meta, record = run.meta, run.meta.get("record") or {}
    table.add_row("run", str(run.path))
    for key in ("kind", "problem", "created", "status", "cost", "return", "iterations", "seed",
                "tags", "revision"):  # fmt: skip
        if meta.get(key) not in (None, []):
            table.add_row(key, _inline(meta[key]))
    for key, value in record.items():
        if value not in (None, {}, []) and key not in ("problem", "seed"):
            table.add_row(key, _inline(value))
    table.add_row("command", " ".join(meta.get("argv") or []))
    table.add_row("versions", _inline(meta.get("versions") or {}))
    table.add_row("arrays", ", ".join(str(name) for name in run.data.data_vars))
    return table


def claim_table(claims: Sequence[Claim]) -> Table:
    """A study's claims: what the paper says, what was measured, whether it holds."""
    from problems.studies.study import verdict

    table = Table(box=None, pad_edge=False, padding=(0, 1, 1, 0))
    for name, share in (("claim", 6), ("source", 4), ("expected", 4), ("measured", 5)):
        table.add_column(name, ratio=share, overflow="fold")
    table.add_column("holds", no_wrap=True)
    marks = {"holds": "yes", "does not hold": "NO"}
    for claim in claims:
        held = verdict(claim.holds, claim.margin)
        cells = (claim.claim, claim.source, claim.expected, claim.measured)
        table.add_row(*map(Text, cells), marks.get(held, held))
    return table


def _inline(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{key}={_inline(item)}" for key, item in value.items())
    if isinstance(value, list):
        return " ".join(map(_inline, value))
    return number(value) if isinstance(value, float) else str(value)
