"""Measure every named problem for the site: verdicts under all laws, methods, cost over the step size.

``python -m docs.generator.verdicts [PROBLEM...]`` (``make verdicts``) solves those problems under
every law and by every method, keeps the rows of others, and draws each exact optimum to
``docs/pictures/problems/<name>.png``; learned laws are trained on transitions from ``ocp collect``.
With ``--refine`` (``make refined``) it refines their steps instead. Each row is stored at once;
a command that exceeds ``--limit`` seconds of processor time has a row that says so.
"""

from __future__ import annotations

import json
import re
import resource
import signal
import subprocess
import sys
import time
from argparse import ArgumentParser
from collections.abc import Iterable, Iterator, Sequence
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from docs.generator import measured
from ocp.judge.step_size import step_size_kind
from ocp.store.runs import load
from problems import get, names, spec
from reports.drawing.strobe import strobe
from reports.drawing.style import house_style
from reports.drawing.view import RunView

LIMIT_S = 120
"""Maximum processor time of one command [s], unless ``--limit`` is given."""
SAMPLES = "2e4"
"""Number of transitions to which learned laws are fitted."""
ANALYTIC = {
    "exact": ("exact",),
    "barrier, mu = 1e-3": ("barrier", "-c", "mu=1e-3"),
    "adaptive, sigma = 0.02": ("adaptive", "-c", "sigma=0.02"),
    "randomized, sigma = 0.1": ("randomized", "-c", "sigma=0.1"),
}
"""Mapping from the title of an analytic law to the arguments of ``--contact``."""
LEARNED = {"EWDA, noise 0.1": "ewda", "MLP, noise 0.1": "mlp"}
"""Mapping from the title of a learned law to the kind of its model."""
MATRIX_LAWS = ("exact", "barrier, mu = 1e-3", "adaptive, sigma = 0.02")
"""Laws in the table of methods."""
METHODS = ("direct", "multiple-shooting", "single-shooting")
"""Methods in the table of methods."""
LARGE = ("hopper", "half-cheetah", "quadruped", "ant", "push-cube", "reorient")
"""Problems with many joints and contacts, for which only :data:`SOLVES_OF_LARGE` are tried."""
SOLVES_OF_LARGE = [("direct", *ANALYTIC[law]) for law in MATRIX_LAWS[:2]]
"""Pairs of a method and a law that are tried on large problems."""
NOT_TRIED = "not tried"
"""Cell for a combination that was not tried."""

Row = list[measured.Cell]


class Measurement:
    """Solves of one problem, each with a limit of processor time [s]; their files are in ``folder``."""

    def __init__(self, problem: str, folder: Path, limit_s: int) -> None:
        self.problem, self.folder, self.limit_s = problem, folder, limit_s
        self.solve = cache(self._solve)
        self.over = f"over {limit_s} s"

    def run_command(self, *words: str) -> dict[str, Any] | str:
        """Run ``ocp`` and return its JSON document; if it fails or exceeds the limit, the reason as text."""
        command = [sys.executable, "-m", "ocp", *words, "--json", "--quiet"]
        limited = partial(resource.setrlimit, resource.RLIMIT_CPU, (self.limit_s, self.limit_s + 5))
        children_s_before, start = _children_seconds(), time.perf_counter()
        done = subprocess.run(command, capture_output=True, text=True, preexec_fn=limited)
        if done.returncode == -signal.SIGXCPU:
            return self.over
        busy = (_children_seconds() - children_s_before) / (time.perf_counter() - start)
        if done.stdout:
            return {**json.loads(done.stdout), "busy": min(busy, 1.0)}
        refusal = re.search("^error: (.*?)(;|$)", done.stderr, re.MULTILINE)
        if refusal is None:
            raise RuntimeError(f"{' '.join(words)} ended with {done.returncode}: {done.stderr[-2000:]}")
        return re.sub(rf"^(\S*\.nc|{re.escape(self.problem)}): ", "", refusal[1])

    def _solve(self, method: str, *law: str) -> dict[str, Any] | str:
        runs = str(self.folder / "runs")
        return self.run_command("solve", self.problem, "--method", method, "--contact", *law, "--out", runs)

    def _solve_unless_hopeless(self, method: str, *law: str) -> dict[str, Any] | str:
        """Solve, unless the problem is large, or a cheaper solve by ``direct`` has exceeded the limit."""
        if self.problem in LARGE and (method, *law) not in SOLVES_OF_LARGE:
            return NOT_TRIED
        cheaper = [("direct", "exact"), ("direct", *law)]
        if any((method, *law) != combination and self.solve(*combination) == self.over for combination in cheaper):
            return NOT_TRIED
        return self.solve(method, *law)

    def verdict_rows(self) -> Iterator[Row]:
        """Yield the rows of the table of verdicts, one per law."""
        for law, words in ANALYTIC.items():
            yield self._verdict_row(law, words)
        data = self.folder / "data.nc"
        collected: dict[str, Any] | str = NOT_TRIED
        if self.problem not in LARGE and self.solve("direct", "exact") != self.over:
            collected = self.run_command("collect", self.problem, "--samples", SAMPLES, "-o", str(data))
        for law, model in LEARNED.items():
            file = str(self.folder / f"{model}.nc")
            learned = collected
            if not isinstance(collected, str):
                learned = self.run_command("learn", str(data), "--model", model, "--noise", "0.1", "-o", file)
            if isinstance(learned, str):
                yield [self.problem, law, learned, *[None] * 5]
            else:
                yield self._verdict_row(law, (model, "-c", f"model={file}"))

    def _verdict_row(self, law: str, words: Sequence[str]) -> Row:
        run = self._solve_unless_hopeless("direct", *words)
        if isinstance(run, str):
            return [self.problem, law, run, *[None] * 5]
        if law == "exact" and (figure := strobe(RunView.of(load(Path(run["run"]))))) is not None:
            measured.save_picture(figure, f"problems/{self.problem}")
        costs = map(digits, (run["cost"], run["exact_cost"], run["referee_cost"]))
        seconds = (run["build_s"] + run["solve_s"]) * run["busy"]
        return [self.problem, law, verdict(run), *costs, run["iterations"], f"{seconds:.2g}"]

    def matrix_rows(self) -> Iterator[Row]:
        """Yield the rows of the table of methods, one per method."""
        for method in METHODS:
            yield [f"`{self.problem}`", method, *(self._matrix_cell(method, ANALYTIC[law]) for law in MATRIX_LAWS)]

    def _matrix_cell(self, method: str, law: Sequence[str]) -> str:
        run = self._solve_unless_hopeless(method, *law)
        if isinstance(run, str):
            return run
        costs = [digits(run[key]) or "–" for key in ("cost", "exact_cost", "referee_cost")]
        mark = "" if run["success"] else f" ({run['status']})"
        return " / ".join([*costs, f"{run['iterations']}{mark}"])

    def refined_rows(self) -> Iterator[Row]:
        """Yield the rows of the table of step sizes, one per size; the last says how the refinement ended."""
        if why := step_size_kind(get(self.problem).system).reason:
            yield [self.problem, *[None] * 4, why]
            return
        words = ("solve", self.problem, "--contact", "exact", "--refine", "--out", str(self.folder))
        run = self.run_command(*words)
        if isinstance(run, str):
            yield [self.problem, *[None] * 4, run]
            return
        levels = run["refined"]["levels"]
        for level in levels:
            end = (run["refined"]["stopped"] or "agree") if level is levels[-1] else ""
            costs = digits(level["cost"]), digits(level["replayed"])
            yield [self.problem, f"{level['h']:.5g}", level["N"], *costs, end]


def _children_seconds() -> float:
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def verdict(run: dict[str, Any]) -> str:
    """Return the verdict of certificate and referee on a solve, as text."""
    if not run["success"]:
        return str(run["status"])
    words = {(True, True): "survives", (False, True): "survives at this step only", (None, None): "no referee"}
    return f"solved, {words.get((run['survives'], run['survives_at_h']), 'does not survive')}"


def digits(cost: float | None) -> str | None:
    """Return a cost to six digits, None for None."""
    return None if cost is None else f"{cost:.6g}"


ABOUT: dict[str, dict[str, Any]] = {
    "verdicts": {
        "title": "Verdicts under every law",
        "command": "make verdicts",
        "columns": ("problem", "law", "verdict", "cost", "exact law", "referee", "iterations", "s"),
        "note": f"Seconds of building and solving, without waiting for a processor; learned laws from {SAMPLES}"
        " transitions. *Over 30 s*: the command was ended after that much processor time; *not tried*: the exact law"
        " was not solved within the limit, or the problem is large, and only the exact law and the barrier are tried.",
    },
    "matrix": {
        "title": "Every problem, law and method",
        "command": "make verdicts",
        "columns": ("problem", "method", *MATRIX_LAWS),
        "note": "*Over 30 s*: the command was ended after that much processor time. *Not tried*: `direct`"
        " was not solved within the limit under that law, or under the exact one, or the problem is large, and only"
        " `direct` under the exact law and the barrier is tried.",
    },
    "refined": {
        "title": "Cost over the step size",
        "command": "make refined",
        "columns": ("problem", "h [s]", "N", "planned", "replayed at h/2", "found"),
        "note": "`ocp solve PROBLEM --contact exact --refine`: each plan starts at the one above it;"
        " the replay holds its inputs over two steps of half the size. *Over 25 s*: the command was ended after that"
        " much processor time.",
    },
}
"""Mapping from the name of a table to its title, command, columns and note."""


def store(table: str, rows: Iterable[Row], keys: int) -> None:
    """Store each row in a table as soon as it is measured; it replaces rows with the same first ``keys`` cells."""
    order = [*names(), *ANALYTIC, *LEARNED, *METHODS]
    replaced: set[tuple[measured.Cell, ...]] = set()
    for row in rows:
        print(table, *row, sep="  ", flush=True)
        key = tuple(row[:keys])
        remaining_rows = [old for old in measured.read(table)["rows"] if key in replaced or tuple(old[:keys]) != key]
        replaced.add(key)
        remaining_rows.append(row)
        remaining_rows.sort(key=lambda row: [order.index(str(cell).strip("`")) for cell in row[:keys]])
        measured.write_table(table, rows=remaining_rows, **ABOUT[table])


def main() -> None:
    """Measure the problems that the command line names, by default all."""
    parser = ArgumentParser(prog="python -m docs.generator.verdicts", description=__doc__)
    parser.add_argument("problems", nargs="*", metavar="PROBLEM")
    parser.add_argument("--refine", action="store_true", help="cost over the step size instead")
    parser.add_argument("--limit", type=int, default=LIMIT_S, metavar="S", help="processor seconds of a command")
    arguments = parser.parse_args()
    for problem in arguments.problems or names():
        with TemporaryDirectory() as folder, house_style():
            measurement = Measurement(spec(problem).name, Path(folder), arguments.limit)
            if arguments.refine:
                store("refined", measurement.refined_rows(), keys=1)
            else:
                store("verdicts", measurement.verdict_rows(), keys=2)
                store("matrix", measurement.matrix_rows(), keys=2)


if __name__ == "__main__":
    main()
