"""The tables of the benchmark of complementarity problems, and its floors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

AUDITED, AT_REFERENCE, CERTIFIED = 186 / 189, 0.97, 1.0
"""Floors: shares of those that are not infeasible, of those audited that have a reference, of those audited."""
TIME_RATIO = 2.0
"""Maximum processor time in sum, relative to the loop's, of the problems that the loop finishes."""


@dataclass(frozen=True)
class Row:
    """Measurements of a problem; ``cost`` and ``reference`` have the sign of the file.

    The reference of an infeasible problem is infinite; ``infeasible`` says whether the solver reports it as such.
    """

    name: str
    n: int = 0
    pairs: int = 0
    cost: float = float("nan")
    reference: float = float("nan")
    stationarity: str = "none"
    kind: str = ""
    audited: bool = False
    infeasible: bool = False
    hit: bool = False
    seconds: float = float("nan")
    strategy: str = ""
    peer_cost: float = float("nan")
    peer_audited: bool = False
    peer_hit: bool = False
    peer_seconds: float = float("nan")
    peer_note: str = ""
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
        if row.infeasible:
            continue
        if not row.audited:
            said.append(f"- {row.name}: not audited. {row.note}")
        elif row.stationarity not in ("B", "KKT"):
            said.append(f"- {row.name}: not certified. {row.note}")
        if row.audited and math.isfinite(row.reference) and not row.hit:
            said.append(f"- {row.name}: {row.cost:.6g}, reference {row.reference:.6g}")
        if row.disproved:
            said.append(f"- {row.name}: certificate disproved, {row.disproved}")
    return said


def counts(rows: Sequence[Row]) -> list[tuple[str, str, str]]:
    """Return lines of a table: what is counted, the count here, and that of the loop."""
    known = [row for row in rows if math.isfinite(row.reference)]
    insoluble = [row for row in rows if math.isinf(row.reference)]
    n_soluble = len(rows) - len(insoluble)
    finished = [row for row in rows if not row.peer_note]
    seconds, peer_s = _seconds(rows)
    both, peer_both = _seconds(finished)
    certified = sum(row.audited and row.stationarity in ("B", "KKT") for row in rows)
    hits = sum(row.hit for row in known)
    return [
        (f"audited, of {n_soluble}", str(sum(row.audited for row in rows)), str(sum(row.peer_audited for row in rows))),
        ("certified, of those", str(certified), ""),
        (
            f"at or below the reference, of {len(known)} that have one",
            str(hits),
            str(sum(row.peer_hit for row in known)),
        ),
        (f"infeasible and reported as such, of {len(insoluble)}", str(sum(row.infeasible for row in insoluble)), ""),
        ("processor seconds in all", f"{seconds:.0f}", f"{peer_s:.0f}"),
        (f"of the {len(finished)} that the loop finishes", f"{both:.0f}", f"{peer_both:.0f}"),
    ]


def _seconds(rows: Sequence[Row]) -> tuple[float, float]:
    """Return the processor times of solver and loop in sum [s]."""
    times = [[row.seconds, row.peer_seconds] for row in rows]
    first, second = np.nansum(times, axis=0) if times else (0.0, 0.0)
    return float(first), float(second)


def summary(rows: Sequence[Row], checked: bool) -> tuple[str, list[str]]:
    """Return counts, floors and failures by name in Markdown, and the floors that are missed."""
    audited = [row for row in rows if row.audited]
    judged = [row for row in audited if math.isfinite(row.reference)]
    soluble = [row for row in rows if not math.isinf(row.reference)]
    certified = [row for row in audited if row.stationarity in ("B", "KKT")]
    both, peer_both = _seconds([row for row in rows if not row.peer_note])
    missed = [
        name
        for name, good in (
            ("audited", _share(len(audited), len(soluble)) >= AUDITED),
            ("at the reference", _share(sum(row.hit for row in judged), len(judged)) >= AT_REFERENCE),
            ("certified", _share(len(certified), len(audited)) >= CERTIFIED),
            ("time", both <= TIME_RATIO * peer_both),
            ("certificates that hold", not any(row.disproved for row in rows)),
        )
        if not good
    ]
    lines = ["| | ocp.mpcc.solve | Scholtes loop |", "|---|---|---|"]
    lines += [f"| {' | '.join(line)} |" for line in counts(rows)]
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
        reference = "infeasible" if math.isinf(row.reference) else f"{row.reference:.6g}".replace("nan", "")
        found = f"{row.cost:.6g}" if row.audited else "infeasible" if row.infeasible else "no answer"
        peer = f"{row.peer_cost:.6g}" if row.peer_audited else "no answer"
        lines.append(
            f"| {row.name} | {row.n} | {row.pairs} | {found} | {reference} |"
            f" {row.stationarity} {row.kind} | {row.seconds:.2f} s | {peer} |"
            f" {row.peer_seconds:.2f} s |"
        )
    return "\n".join(lines)
