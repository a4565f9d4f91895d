"""Measure every named problem for the gallery: verdicts under all laws, cost over the step size.

``python -m docs.generator.verdicts [PROBLEM...]`` (``make verdicts``) solves those problems under
every law, keeps the rows of others, and draws each exact optimum to
``docs/pictures/problems/<name>.png``; learned laws are trained on transitions from ``ocp collect``.
With ``--refine`` (``make refined``) it refines their steps instead; files work too.
"""

from __future__ import annotations

import json
import re
import resource
import subprocess
import sys
from argparse import ArgumentParser
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from docs.generator import measured
from ocp.judge.referee import step_size_kind
from ocp.store.runs import load
from problems import get, names, spec
from reports.drawing.strobe import strobe
from reports.drawing.style import house_style
from reports.drawing.view import RunView

LIMIT_S, REFINE_LIMIT_S = 120, 3600
"""Seconds of processor time for one solve, and for the refinement of one problem."""
SAMPLES = "2e4"
COLUMNS = ("problem", "law", "verdict", "cost", "exact law", "referee", "iterations", "s")
ANALYTIC = {
    "exact": ("exact",),
    "barrier, mu = 1e-3": ("barrier", "-c", "mu=1e-3"),
    "adaptive, sigma = 0.02": ("adaptive", "-c", "sigma=0.02"),
    "randomized, sigma = 0.1": ("randomized", "-c", "sigma=0.1"),
}
LEARNED = {"EWDA, noise 0.1": "ewda", "MLP, noise 0.1": "mlp"}

Row = list[measured.Cell]


def problem_rows(name: str, folder: Path) -> Iterator[Row]:
    """Rows of one problem, one per law; ``folder`` holds intermediate files."""
    for law, words in ANALYTIC.items():
        yield solved(name, law, words, folder)
    data = folder / "data.nc"
    drawn = answer(["collect", name, "--samples", SAMPLES, "-o", str(data)])
    for law, model in LEARNED.items():
        file = folder / f"{model}.nc"
        words = ["learn", str(data), "--model", model, "--noise", "0.1", "-o", str(file)]
        learned = drawn if isinstance(drawn, str) else answer(words)
        if isinstance(learned, str):
            yield [name, law, learned, *[None] * 5]
        else:
            yield solved(name, law, (model, "-c", f"model={file}"), folder)


def solved(name: str, law: str, words: Sequence[str], folder: Path) -> Row:
    """Solve under one law; a solve longer than :data:`LIMIT_S` has a row without numbers."""
    found = answer(["solve", name, "--contact", *words, "--out", str(folder / "runs")])
    if isinstance(found, str):
        return [name, law, found, *[None] * 5]
    if law == "exact" and (figure := strobe(RunView.of(load(Path(found["run"]))))) is not None:
        measured.save_picture(figure, f"problems/{name}")
    costs = (found["cost"], found["exact_cost"], found["referee_cost"])
    seconds = f"{found['build_s'] + found['solve_s']:.2g}"
    return [name, law, verdict(found), *map(digits, costs), found["iterations"], seconds]


def verdict(found: dict[str, Any]) -> str:
    """Verdict of certificate and referee, as text."""
    if not found["success"]:
        return str(found["status"])
    words = {(True, True): "survives", (False, True): "survives at this step only", (None, None): "no referee"}
    return f"solved, {words.get((found['survives'], found['survives_at_h']), 'does not survive')}"


def digits(value: float | None) -> str | None:
    """Write a cost to six digits."""
    return None if value is None else f"{value:.6g}"


def answer(words: Sequence[str], limit: int = LIMIT_S) -> dict[str, Any] | str:
    """The JSON document of ``ocp``; a refusal or a time limit as text."""
    command = [sys.executable, "-m", "ocp", *words, "--json", "--quiet"]
    limited = partial(resource.setrlimit, resource.RLIMIT_CPU, (limit, limit))
    done = subprocess.run(command, capture_output=True, text=True, preexec_fn=limited)
    try:
        return json.loads(done.stdout)
    except json.JSONDecodeError:
        refused = [line for line in done.stderr.splitlines() if line.startswith("error: ")]
        reason = refused[0].removeprefix("error: ").partition("; ")[0] if refused else ""
        return re.sub(r"^\S*\.nc: ", "", reason) or f"over {limit} s"


def store(table: str, name: str, rows: Sequence[Row], order: list[str], **about: Any) -> None:
    """Put the rows of one problem into a table, in the ``order`` of problems."""
    file = measured.DATA / f"{table}.json"
    old = measured.read(table)["rows"] if file.exists() else []
    every = [*(row for row in old if row[0] != name), *rows]
    every.sort(key=lambda row: order.index(str(row[0])))
    measured.write_table(table, rows=every, **about)


def refinable() -> list[str]:
    """The named problems whose h only discretises, and an arm at a wall."""
    found = [name for name in names() if step_size_kind(get(name).system).kind != "fixed"]
    return [*found, "examples/double_pendulum_walls.py"]


def refined_rows(problem: str, folder: str) -> Iterator[Row]:
    """Rows of one problem, one per step size; the last says how the refinement ended."""
    words = ["solve", problem, "--contact", "exact", "--refine", "--out", folder]
    found, name = answer(words, REFINE_LIMIT_S), Path(problem).stem
    if isinstance(found, str):
        yield [name, *[None] * 4, found]
        return
    levels = found["refined"]["levels"]
    for one in levels:
        end = (found["refined"]["stopped"] or "agree") if one is levels[-1] else ""
        costs = digits(one["cost"]), digits(one["replayed"])
        yield [name, f"{one['h']:.5g}", one["N"], *costs, end]


def store_refined(problem: str, rows: Sequence[Row]) -> None:
    """Put the rows of one problem into the table of step sizes."""
    store(
        "refined",
        Path(problem).stem,
        rows,
        [Path(name).stem for name in refinable()],
        title="Cost over the step size",
        command="make refined",
        columns=("problem", "h [s]", "N", "planned", "replayed at h/2", "found"),
        note="`ocp solve PROBLEM --contact exact --refine`: each plan starts at the one above it;"
        " the replay holds its inputs over two steps of half the size.",
    )


def main() -> None:
    """Measure the problems of the command line, by default all."""
    parser = ArgumentParser(prog="python -m docs.generator.verdicts", description=__doc__)
    parser.add_argument("problems", nargs="*", metavar="PROBLEM")
    parser.add_argument("--refine", action="store_true", help="cost over the step size instead")
    given = parser.parse_args()
    for name in given.problems or (refinable() if given.refine else names()):
        with TemporaryDirectory() as folder, house_style():
            if given.refine:
                store_refined(name, rows := list(refined_rows(name, folder)))
            else:
                rows = list(problem_rows(spec(name).name, Path(folder)))
                note = f"Seconds of building and solving; learned laws from {SAMPLES} transitions."
                store(
                    "verdicts",
                    name,
                    rows,
                    [*names()],
                    title="Verdicts under every law",
                    command="make verdicts",
                    columns=COLUMNS,
                    note=note,
                )
        for row in rows:
            print(*row, sep="  ", flush=True)


if __name__ == "__main__":
    main()
