"""One ``ocp solve`` in a new process: its answer, and its processor time with that of its children."""

from __future__ import annotations

import json
import math
import resource
import shlex
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import netCDF4
import numpy as np

from problems import get
from tests.benchmarks.found.problems import ROOT, Plan, rounded, source_of

RUNS = ROOT / "runs" / "found"
"""Folder of the runs; not in the repository."""
PROGRAM = "from reports.cli.start import main; main()"


@dataclass(frozen=True)
class Answer:
    """Answer of one command; costs are NaN without an answer.

    ``exact_cost`` is that of the inputs under the exact law, infinite if they violate a constraint; ``survives`` is
    the referee's verdict, ``survives_at_h`` that at the step size itself, and ``seconds`` processor time.
    """

    name: str
    command: str
    status: str
    seconds: float
    cost: float = math.nan
    exact_cost: float = math.nan
    certificate: str = "none"
    survives: bool = False
    survives_at_h: bool = False
    run: str = ""

    def plan(self) -> Plan:
        """Return its inputs as a plan, from the stored run."""
        with netCDF4.Dataset(Path(self.run) / "solution.nc") as solution:
            inputs, states = (np.asarray(solution[key][:])[0] for key in ("u", "x"))
        is_start_free = get(source_of(self.name)).start is not None
        return Plan(self.exact_cost, self.command, rounded(inputs), rounded(states[0]) if is_start_free else None)


def answer_of(name: str, arguments: Sequence[str] = ()) -> Answer:
    """Solve a problem by ``ocp solve`` with more ``arguments``, and wait for it."""
    words = ["solve", source_of(name), *arguments]
    command = shlex.join(["ocp", *("@last" if word.startswith(str(RUNS)) else word for word in words)])
    before = _children_seconds()
    program = [sys.executable, "-c", PROGRAM, *words, "--json", "--quiet", "--out", str(RUNS)]
    process = subprocess.run(program, capture_output=True, text=True, cwd=ROOT, check=False)
    seconds = _children_seconds() - before
    if not process.stdout.startswith("{"):
        lines = process.stderr.strip().splitlines()
        return Answer(name, command, lines[-1] if lines else f"exit code {process.returncode}", seconds)
    document = json.loads(process.stdout)
    broken = bool(document["replay_broken"]) or document["exact_cost"] is None
    return Answer(
        name,
        command,
        document["status"],
        seconds,
        _number(document["cost"]),
        math.inf if broken else _number(document["exact_cost"]),
        document["stationarity"] if document["success"] else "none",
        bool(document["survives"]),
        bool(document["survives_at_h"]),
        document["run"],
    )


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)


def _children_seconds() -> float:
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime
