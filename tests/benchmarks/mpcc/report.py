"""The tables of the benchmark of complementarity problems, and its floors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

AUDITED, AT_REFERENCE, CERTIFIED = 147 / 150, 0.97, 0.98
"""Floors: shares of all, of those audited that have a reference, of those audited."""


@dataclass(frozen=True)
class Row:
    """Measurements of a problem; ``cost`` and ``reference`` have the sign of the file."""

    name: str
    n: int = 0
    pairs: int = 0
    cost: float = float("nan")
    reference: float = float("nan")
    stationarity: str = "none"
    kind: str = ""
    audited: bool = False
    hit: bool = False
    seconds: float = float("nan")
    strategy: str = ""
    peer_cost: float = float("nan")
    peer_audited: bool = False
    peer_hit: bool = False
    peer_seconds: float = float("nan")
    note: str = ""
    disproved: str = ""


def line(row: Row) -> str:
    """Return a line on one problem to be printed during the run."""
    return (
        f"{row.name:18s} {row.cost:13.6g} {row.reference:12.6g} {row.peer_cost:13.6g}"
        f" {'audited' if row.audited else '-':8s}{'hit' if row.hit else '-':4s}"
        f"{row.stationarity:10s} {row.kind:2s}{row.seconds:8.3f} s {row.peer_seconds:8.3f} s"
        f" {row.strategy:18s} {'' if row.audited else row.note[:90]}{row.disproved}"
    )


def _share(part: int, whole: int) -> float:
    return part / whole if whole else 1.0


def _failures(rows: Sequence[Row]) -> list[str]:
    said = []
    for row in rows:
        if not row.audited:
            said.append(f"- {row.name}: not audited. {row.note}")
        elif row.stationarity not in ("B", "KKT"):
            said.append(f"- {row.name}: not certified. {row.note}")
        if row.audited and not math.isnan(row.reference) and not row.hit:
            said.append(f"- {row.name}: {row.cost:.6g}, reference {row.reference:.6g}")
        if row.disproved:
            said.append(f"- {row.name}: certificate disproved, {row.disproved}")
    return said


def summary(rows: Sequence[Row], checked: bool) -> tuple[str, list[str]]:
    """Return counts, floors and failures by name in Markdown, and the floors that are missed."""
    audited = [row for row in rows if row.audited]
    known = [row for row in rows if not math.isnan(row.reference)]
    judged = [row for row in known if row.audited]
    hits, certified = sum(row.hit for row in judged), [row for row in audited if row.stationarity in ("B", "KKT")]
    seconds, peer_s = (
        sum(getattr(row, what) for row in rows if not math.isnan(getattr(row, what)))
        for what in ("seconds", "peer_seconds")
    )
    missed = [
        name
        for name, good in (
            ("audited", _share(len(audited), len(rows)) >= AUDITED),
            ("at the reference", _share(hits, len(judged)) >= AT_REFERENCE),
            ("certified", _share(len(certified), len(audited)) >= CERTIFIED),
            ("time", seconds < peer_s),
            ("certificates that hold", not any(row.disproved for row in rows)),
        )
        if not good
    ]
    lines = [
        "| | ocp.mpcc.solve | Scholtes loop |",
        "|---|---|---|",
        f"| audited, of {len(rows)} | {len(audited)} | {sum(row.peer_audited for row in rows)} |",
        f"| at or below the reference, of {len(known)} | {hits} | {sum(row.peer_hit for row in known)} |",
        f"| certified B-stationary, of those audited | {len(certified)} | |",
        f"| time, sum | {seconds:.1f} s | {peer_s:.1f} s |",
    ]
    if checked:
        lines.append(f"| certificates disproved | {sum(bool(row.disproved) for row in rows)} | |")
    lines += ["", f"Floors missed: {', '.join(missed) or 'none'}.", "", *_failures(rows)]
    return "\n".join(lines), missed


def table(rows: Sequence[Row]) -> str:
    """Return the table of all problems in Markdown."""
    lines = [
        "| problem | n | pairs | cost | reference | stationary | time | Scholtes loop | time |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        reference = "" if math.isnan(row.reference) else f"{row.reference:.6g}"
        found = f"{row.cost:.6g}" if row.audited else "no answer"
        peer = f"{row.peer_cost:.6g}" if row.peer_audited else "no answer"
        lines.append(
            f"| {row.name} | {row.n} | {row.pairs} | {found} | {reference} |"
            f" {row.stationarity} {row.kind} | {row.seconds:.2f} s | {peer} |"
            f" {row.peer_seconds:.2f} s |"
        )
    return "\n".join(lines)
