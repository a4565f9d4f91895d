"""Measure ``ocp.mpcc.solve`` on a directory of AMPL .nl files, against a plain Scholtes loop.

    python -m tests.benchmarks.mpcc.bench DIR [--only NAME ...] [--cross-check] [--out FILE]

DIR holds .nl files, at any depth, and ``reference.csv`` with columns name and solution. Every
problem is read and solved in a child process with a limit of its processor time, so none can stop the
run. Times are processor times, so that other programs on the computer change little; imports are not counted.
Rows are stored as they come, so that the same command continues where it was stopped; small files are first.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
import multiprocessing as mp
import resource
import signal
import sys
import time
from collections.abc import Callable
from dataclasses import asdict
from decimal import Decimal, InvalidOperation
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import scipy.sparse.csgraph
import scipy.sparse.linalg  # noqa: F401  a first solve imports it

from docs.generator.measured import write_table
from ocp.mpcc import MPCC, MPCCSolution, solve
from ocp.mpcc.nl import read_nl
from ocp.programs.solver import Status
from ocp.store.atomic import write_file
from ocp.store.provenance import git_revision
from tests.benchmarks.mpcc import report, scholtes_peer
from tests.benchmarks.mpcc.report import Row

FEASIBLE, COMPLEMENTARY = 1e-6, 1e-6
"""Tolerances of the audit: violation of bounds and rows; min(G, H), or for the loop G H if smaller."""
RELATIVE, ABSOLUTE = 1e-4, 1e-6
"""A cost is at the reference if it exceeds it by no more than these and the rounding of its digits."""
LIMIT_S = 120
"""Processor time of one solve after which it counts as not finished."""
ROWS = Path("runs/bench-mpcc.json")
"""File of the rows so far."""
_STARTS = 5


def residuals(mpcc: MPCC, x: np.ndarray) -> tuple[float, float, float]:
    """Return the violation of bounds, rows and signs; the largest |min(G, H)|; the largest |G H|."""
    g, G, H = (np.array(v).ravel() for v in ca.Function("all", [mpcc.x], [mpcc.g, mpcc.G, mpcc.H])(x))
    (lbx, ubx), (lbg, ubg) = mpcc.x_bounds, mpcc.g_bounds
    off = np.concatenate([lbx - x, x - ubx, lbg - g, g - ubg, -G, -H])
    worst = float(np.max(np.nan_to_num(off, nan=np.inf), initial=0.0))
    apart = float(np.abs(np.minimum(G, H)).max(initial=0.0))
    return worst, apart, float(np.abs(G * H).max(initial=0.0))


def at_reference(cost: float, reference: tuple[float, float], sense: float) -> bool:
    """Return whether a cost is as good as a reference (with its rounding); ``sense`` 1 is minimised."""
    best, rounding = reference
    return bool(sense * (cost - best) <= ABSOLUTE + RELATIVE * abs(best) + rounding)


def measure(path: Path, reference: tuple[float, float], check: bool) -> dict[str, Any]:
    """Solve and audit one file; return fields of a :class:`~tests.benchmarks.mpcc.report.Row`."""
    stated = read_nl(path)
    mpcc, sense = stated.mpcc, -1.0 if stated.maximise else 1.0
    began = time.process_time()
    found = solve(mpcc, stated.start)
    seconds = time.process_time() - began
    worst, apart, _ = residuals(mpcc, found.x)
    audited = worst <= FEASIBLE and apart <= COMPLEMENTARY
    return {
        "n": mpcc.x.numel(),
        "pairs": mpcc.G.numel(),
        "cost": sense * found.f,
        "stationarity": found.certificate.stationarity,
        "kind": found.certificate.kind,
        "audited": audited,
        "infeasible": math.isinf(reference[0]) and found.status is Status.INFEASIBLE,
        "hit": audited and at_reference(sense * found.f, reference, sense),
        "seconds": seconds,
        "strategy": found.strategy,
        "note": found.verdict,
        "disproved": disproof(mpcc, stated.start, found) if check and found.success else "",
    }


def measure_peer(path: Path, reference: tuple[float, float]) -> dict[str, Any]:
    """Do the same with the loop; the smaller of product and minimum counts as its complementarity."""
    stated = read_nl(path)
    mpcc, sense = stated.mpcc, -1.0 if stated.maximise else 1.0
    began = time.process_time()
    found = scholtes_peer.solve(mpcc, stated.start)
    seconds = time.process_time() - began
    worst, apart, product = residuals(mpcc, found.x)
    audited = worst <= FEASIBLE and min(apart, product) <= COMPLEMENTARY
    return {
        "peer_cost": sense * found.f,
        "peer_audited": audited,
        "peer_hit": audited and at_reference(sense * found.f, reference, sense),
        "peer_seconds": seconds,
    }


def disproof(mpcc: MPCC, start: np.ndarray, found: MPCCSolution) -> str:
    """Return how solutions from five other starts disprove a certificate; "" if they do not.

    Three starts are near the solution, a thousandth of the variables' sizes away, two near the given
    start, a size away. A solution disproves if it costs less, is at most a hundredth of the sizes
    away, and the slope is more than the certificate's tolerance: there is then a descent to first
    order. A certificate says nothing of other minima farther away.
    """
    rng = np.random.default_rng(0)
    size, whole = np.maximum(1.0, np.abs(found.x)), np.maximum(1.0, np.abs(start))
    near = [found.x + 1e-3 * size * rng.standard_normal(size.size) for _ in range(3)]
    far = [start + whole * rng.standard_normal(size.size) for _ in range(_STARTS - 3)]
    for i, begin in enumerate([*near, *far]):
        other = solve(mpcc, begin)
        worst, apart, _ = residuals(mpcc, other.x)
        step = float(np.max(np.abs(other.x - found.x) / size, initial=0.0))
        if worst > FEASIBLE or apart > COMPLEMENTARY or not 0 < step < 1e-2:
            continue
        gained = found.f - other.f
        if gained > step * found.certificate.tolerance and gained > ABSOLUTE:
            return f"start {i} falls by {gained:.2g} within {step:.1g}"
    return ""


def _child(pipe: Connection, limit: int, work: Callable[..., dict[str, Any]], *given: Any) -> None:
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_CPU, (limit, limit))
    try:
        pipe.send(work(*given))
    except Exception as error:  # the run continues, and the table shows the error
        pipe.send({"note": f"{type(error).__name__}: {error}"[:200]})


def limited(limit: int, charged: str, work: Callable[..., dict[str, Any]], *given: Any) -> dict[str, Any]:
    """Do work in a child process with a limit of processor time [s]; without a result a note says why.

    If the limit ends the process, the limit is stored under ``charged``.
    """
    context = mp.get_context("fork")
    ours, theirs = context.Pipe(duplex=False)
    child = context.Process(target=_child, args=(theirs, limit, work, *given))
    child.start()
    theirs.close()
    try:
        return ours.recv()
    except EOFError:
        child.join()
        if child.exitcode in (-signal.SIGXCPU, -signal.SIGKILL):
            return {charged: float(limit), "note": f"not finished in {limit} s of processor time"}
        return {"note": "the process ended without an answer"}
    finally:
        child.join()


def measured(path: Path, reference: tuple[float, float], limit: int, check: bool) -> Row:
    """Measure one file by the solver and the loop."""
    longest = limit * (_STARTS + 1 if check else 1)
    found = limited(longest, "seconds", measure, path, reference, check)
    peer = limited(limit, "peer_seconds", measure_peer, path, reference)
    return Row(path.stem, reference=reference[0], peer_note=peer.pop("note", ""), **{**peer, **found})


def references(folder: Path) -> dict[str, tuple[float, float]]:
    """Return best known costs by name, each with half a unit of its last digit; inf if infeasible, else skipped."""
    found: dict[str, tuple[float, float]] = {}
    for table in folder.rglob("reference.csv"):
        with table.open() as lines:
            for line in csv.DictReader(lines):
                if line["solution"] == "(I)":
                    found[line["name"]] = math.inf, 0.0
                    continue
                try:
                    value = Decimal(line["solution"])
                except InvalidOperation:
                    continue
                exponent = int(value.as_tuple().exponent)
                found[line["name"]] = float(value), 0.5 * 10.0**exponent
    return found


def _identity(limit: int, check: bool) -> dict[str, Any]:
    return {"commit": git_revision(), "limit": limit, "check": check}


def stored_rows(file: Path, identity: dict[str, Any]) -> dict[str, Row]:
    """Return rows by name that ``file`` holds of the same commit, limit and check; none of others."""
    content = json.loads(file.read_text()) if file.exists() else {}
    is_same = content.get("identity") == identity
    return {name: Row(**fields) for name, fields in content["rows"].items()} if is_same else {}


def main(arguments: list[str] | None = None) -> int:
    """Run the benchmark; return 1 if a floor is missed."""
    parser = argparse.ArgumentParser(prog="bench-mpcc")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", nargs="*", default=[])
    parser.add_argument("--cross-check", action="store_true")
    parser.add_argument("--limit", type=int, default=LIMIT_S)
    parser.add_argument("--out", type=Path, default=Path(__file__).with_name("results.md"))
    given = parser.parse_args(arguments)
    known, identity = references(given.folder), _identity(given.limit, given.cross_check)
    stored = {} if given.only else stored_rows(ROWS, identity)
    for path in sorted(given.folder.rglob("*.nl"), key=lambda path: (path.stat().st_size, path.stem)):
        if path.stem in stored or (given.only and path.stem not in given.only):
            continue
        stored[path.stem] = measured(path, known.get(path.stem, (math.nan, 0.0)), given.limit, given.cross_check)
        print(report.line(stored[path.stem]), flush=True)
        if not given.only:
            content = {"identity": identity, "rows": {name: asdict(row) for name, row in stored.items()}}
            write_file(ROWS, json.dumps(content).encode())
    rows = [stored[name] for name in sorted(stored)]
    text, missed = report.summary(rows, given.cross_check)
    print(text)
    if not given.only:
        given.out.write_text(text + "\n\n" + report.table(rows) + "\n")
        write_table(
            "mpcc",
            title="MacMPEC",
            command="make bench-mpcc DIR=path/to/nl/files",
            columns=["", "here", "a plain Scholtes loop"],
            rows=report.counts(rows),
            note=f"What takes more than {given.limit} s of processor time is not finished.",
        )
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
