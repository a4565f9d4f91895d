"""Every named problem by every solver, under the barrier and the exact law: the site's table.

``make bench-solvers`` runs it; ``PROBLEMS="hopper push-1d"`` selects some of them, and rewrites
their rows alone. Each solve is a separate process that ends after a :func:`limit` of processor
time, since not all solvers have a time limit.
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from docs.generator.measured import DATA, read, write_table
from ocp.programs.solver import SOLVERS
from ocp.solve.solve import solve
from problems import names, spec

TABLE = "solvers"
LAWS = ("barrier", "exact")
DEFAULT = "ipopt"
SAME = 1e-3
"""Relative difference of costs above which the optimum is reported as another one."""


@dataclass(frozen=True)
class Solved:
    """Result of one solve; ``seconds`` of processor time include building and verification."""

    status: str
    success: bool
    cost: float
    seconds: float


def limit(solver: str) -> int:
    """Return the limit [s] on processor time of one solve: a minute for the default solver, else a sixth."""
    return 60 if solver == DEFAULT else 10


def here(problem: str, law: str, solver: str) -> Solved:
    """Solve in this process."""
    began = time.process_time()
    found = solve(problem, law, solver=solver)
    return Solved(found.status.label, found.success, found.cost, time.process_time() - began)


def apart(problem: str, law: str, solver: str) -> Solved:
    """Solve in a separate process, at low priority."""
    words = [sys.executable, "-m", __spec__.name, "--one", problem, law, solver]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as child:
        # The limit is checked from outside, since a timer inside slows SLEQP down thirtyfold.
        while child.poll() is None and processor_s(child.pid) < limit(solver):
            time.sleep(0.1)
        over = child.poll() is None
        child.kill()
        told, _ = child.communicate()
    # Uno prints to the same stream which variables have equal bounds.
    _, begun, answer = told.partition("{")
    if begun:
        return Solved(**json.loads(begun + answer))
    return Solved(f"> {limit(solver)} s" if over else "stopped", False, math.nan, math.nan)


def processor_s(pid: int) -> float:
    """Return the processor time [s] of a process, from Linux."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return sum(map(int, fields[11:13])) / os.sysconf("SC_CLK_TCK")


def cell(found: Solved, best: float) -> str:
    """Return seconds or status of one solve as text, with its cost if that differs from ``best``."""
    if math.isnan(found.seconds):
        return found.status
    other = found.success and abs(found.cost - best) > SAME * abs(best)
    what = f"{found.seconds:.2g} s" if found.success else f"{found.status}, {found.seconds:.2g} s"
    return f"{what}, at {found.cost:.4g}" if other else what


def row(problem: str, law: str) -> list[str]:
    """Measure one problem under one law by all solvers."""
    found = {solver: apart(problem, law, solver) for solver in SOLVERS}
    best = min((one.cost for one in found.values() if one.success), default=float("nan"))
    print(problem, law, {solver: cell(one, best) for solver, one in found.items()}, flush=True)
    return [f"`{problem}`", law, f"{best:.6g}", *(cell(one, best) for one in found.values())]


def store(fresh: Sequence[Sequence[str]]) -> None:
    """Write rows into the table of the site, in the order of the registry."""
    old = read(TABLE)["rows"] if (DATA / f"{TABLE}.json").exists() else []
    rows = {(cells[0], cells[1]): list(cells) for cells in (*old, *fresh)}
    order = [(f"`{name}`", law) for name in names() for law in LAWS]
    write_table(
        TABLE,
        title="Every problem by every solver",
        command="make bench-solvers",
        columns=("problem", "law", "best cost", *SOLVERS),
        rows=[rows[key] for key in order if key in rows],
        note="Processor time of a solve that is certified; else the status, or what time was not"
        " enough. A cost is told where it is not the best one.",
    )


def main() -> int:
    """Measure, and store the table after every row."""
    if sys.argv[1:2] == ["--one"]:
        os.nice(10)
        print(json.dumps(asdict(here(*sys.argv[2:]))))
        return 0
    chosen = [spec(name).name for name in sys.argv[1:]] or names()
    rows: list[list[str]] = []
    for law in LAWS:
        for name in chosen:
            rows.append(row(name, law))
            store(rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
