"""Table of the remedy that makes the plan of every named problem survive: ``ocp solve NAME --until survives``.

``make bench-survives`` runs it and rewrites the site's table; ``PROBLEMS="hopper push-1d"`` measures some of them, and
``LIMIT=300`` ends each command after so many seconds of processor time. Rows are stored as they come.
"""

from __future__ import annotations

import json
import math
import resource
import signal
import subprocess
import sys
from argparse import ArgumentParser
from functools import partial
from tempfile import TemporaryDirectory
from typing import Any

from docs.generator.measured import DATA, Cell, read, write_table
from problems import names

TABLE = "survives"
COLUMNS = (
    "problem",
    "remedy",
    "plan",
    "plan at h/4",
    "remedy's cost",
    "noise",
    "friction",
    "masses",
    "late",
    "h/16",
    "iterations",
    "s",
)
LIMIT_S = 900
"""Seconds of processor time of one command."""
NOTE = (
    "`ocp solve PROBLEM --contact exact --effort quick --until survives`. *Plan*: the first plan's cost; *at h/4*: that"
    " of its inputs under the most exact contact model at a quarter of the step, or at the step where it is part of the"
    " model; *remedy's cost*: that of the answer there. *Noise*, *friction*, *masses*: draws of 20 that the answer"
    " survives. *Late*: whether it survives inputs that are one step of the first plan late; *h/16*: a sixteenth of its"
    " own step. *Iterations*: those of all remedies over those of the plan. Seconds of processor time."
)


def solved(problem: str, limit_s: int) -> tuple[dict[str, Any] | None, float]:
    """Return the document of one command, None where it exceeded the limit, and seconds of processor time."""
    before = _children_seconds()
    with TemporaryDirectory() as folder:
        words = ("solve", problem, "--contact", "exact", "--effort", "quick", "--until", "survives", "--out", folder)
        command = [sys.executable, "-m", "ocp", *words, "--json", "--quiet"]
        limited = partial(resource.setrlimit, resource.RLIMIT_CPU, (limit_s, limit_s + 5))
        done = subprocess.run(command, capture_output=True, text=True, preexec_fn=limited)
    seconds = _children_seconds() - before
    if done.returncode == -signal.SIGXCPU:
        return None, seconds
    if done.returncode not in (0, 3):
        raise RuntimeError(f"{problem} ended with {done.returncode}: {done.stderr[-2000:]}")
    return json.loads(done.stdout), seconds


def row(problem: str, limit_s: int) -> list[Cell]:
    """Return the row of one problem."""
    document, seconds = solved(problem, limit_s)
    if document is None:
        return [problem, f"over {limit_s} s", *[None] * 9, f"{seconds:.0f}"]
    ladder = document["ladder"]
    first, answer = ladder["rungs"][0], ladder["rungs"][ladder["chosen"]]
    remedy = answer["name"] if answer["survives"] else f"none; best: {answer['name']}"
    survived = {entry["disturbance"].split()[0]: entry["survived"] for entry in ladder["disturbed"]}
    draws = [None if name not in survived else str(survived[name]) for name in ("noise", "friction", "masses")]
    once = [None if name not in survived else bool(survived[name]) for name in ("inputs", "h/16")]
    costs = (first["planned"], _most_exact_cost(first), _most_exact_cost(answer))
    iterations = document["iterations"] / max(first["iterations"], 1)
    cells = [*map(_digits, costs), *draws, *once]
    return [problem, remedy, *cells, f"{iterations:.2g}", f"{seconds:.0f}"]


def _most_exact_cost(rung: dict[str, Any]) -> float | None:
    refined = rung["refined_cost"]
    return rung["cost"] if refined is None or not math.isfinite(refined) else refined


def _digits(cost: float | None) -> str | None:
    return None if cost is None else f"{cost:.6g}"


def _children_seconds() -> float:
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def main() -> None:
    """Measure problem after problem, and store each row as it comes."""
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("problems", nargs="*", default=names(), metavar="PROBLEM")
    parser.add_argument("--limit", type=int, default=LIMIT_S, help="seconds of processor time of one command")
    arguments = parser.parse_args()
    for problem in arguments.problems or names():
        fresh = row(problem, arguments.limit)
        print("  ".join("–" if cell is None else str(cell) for cell in fresh), flush=True)
        old = read(TABLE)["rows"] if (DATA / f"{TABLE}.json").exists() else []
        rows = [cells for cells in old if cells[0] != fresh[0]] + [fresh]
        write_table(
            TABLE,
            title="What makes plans survive",
            command="make bench-survives",
            columns=COLUMNS,
            rows=sorted(rows, key=lambda cells: names().index(cells[0])),
            note=NOTE,
        )


if __name__ == "__main__":
    main()
