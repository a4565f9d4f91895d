"""Solve every named problem under every law, for the pages of the gallery; ``make verdicts``.

``python -m reports.site.verdicts [PROBLEM...]`` measures those problems, keeps the rows of others,
and draws each exact optimum to ``docs/pictures/problems/<name>.png``. Learned laws are trained on
transitions that ``ocp collect`` draws first.
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

from ocp.store.runs import load
from problems import names, spec
from reports.site import measured, pictures
from reports.strobe import strobe
from reports.style import styled
from reports.view import RunView

LIMIT_S = 120
"""Seconds of processor time that a solve may take."""
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


def of_problem(name: str, room: Path) -> Iterator[Row]:
    """Rows of one problem, a law after the other; what is made on the way lies in ``room``."""
    for law, words in ANALYTIC.items():
        yield solved(name, law, words, room)
    data = room / "data.nc"
    drawn = told(["collect", name, "--samples", SAMPLES, "-o", str(data)])
    for law, model in LEARNED.items():
        file = room / f"{model}.nc"
        words = ["learn", str(data), "--model", model, "--noise", "0.1", "-o", str(file)]
        learned = drawn if isinstance(drawn, str) else told(words)
        if isinstance(learned, str):
            yield [name, law, learned, *[None] * 5]
        else:
            yield solved(name, law, (model, "-c", f"model={file}"), room)


def solved(name: str, law: str, words: Sequence[str], room: Path) -> Row:
    """Solve under one law; one that takes longer than :data:`LIMIT_S` has no numbers."""
    found = told(["solve", name, "--contact", *words, "--out", str(room / "runs")])
    if isinstance(found, str):
        return [name, law, found, *[None] * 5]
    if law == "exact":
        draw(name, Path(found["run"]))
    costs = (found["cost"], found["exact_cost"], found["referee_cost"])
    seconds = f"{found['build_s'] + found['solve_s']:.2g}"
    return [name, law, verdict(found), *map(digits, costs), found["iterations"], seconds]


def verdict(found: dict[str, Any]) -> str:
    """Say in words what certificate and referee found."""
    if not found["success"]:
        return str(found["status"])
    words = {(True, True): "survives", (False, True): "survives at this step only",
             (None, None): "no referee"}  # fmt: skip
    told = words.get((found["survives"], found["survives_at_h"]), "does not survive")
    return f"solved, {told}"


def digits(value: float | None) -> str | None:
    """Write a cost as verdicts do."""
    return None if value is None else f"{value:.6g}"


def told(words: Sequence[str], limit: int = LIMIT_S) -> dict[str, Any] | str:
    """Return the JSON document that ``ocp`` prints, or why there is none: refused, or too long."""
    command = [sys.executable, "-m", "ocp", *words, "--json", "--quiet"]
    limited = partial(resource.setrlimit, resource.RLIMIT_CPU, (limit, limit))
    done = subprocess.run(command, capture_output=True, text=True, preexec_fn=limited)
    try:
        return json.loads(done.stdout)
    except json.JSONDecodeError:
        refused = [line for line in done.stderr.splitlines() if line.startswith("error: ")]
        said = refused[0].removeprefix("error: ").partition("; ")[0] if refused else ""
        return re.sub(r"^\S*\.nc: ", "", said) or f"over {limit} s"


def draw(name: str, run: Path) -> None:
    """Draw the strobe of a run as the picture of its problem."""
    figure = strobe(RunView.of(load(run)))
    if figure is not None:
        pictures.save(figure, f"problems/{name}")


def store(name: str, rows: Sequence[Row]) -> None:
    """Put the rows of one problem into the table, in the order of the registry."""
    file = measured.DATA / "verdicts.json"
    old = measured.read("verdicts")["rows"] if file.exists() else []
    every = [*(row for row in old if row[0] != name), *rows]
    measured.write_table(
        "verdicts",
        title="Verdicts under every law",
        command="make verdicts",
        columns=COLUMNS,
        rows=sorted(every, key=lambda row: names().index(str(row[0]))),
        note=f"Seconds of building and solving; learned laws from {SAMPLES} transitions.",
    )


def main() -> None:
    """Measure the problems that the command line names, all where it names none."""
    parser = ArgumentParser(prog="python -m reports.site.verdicts", description=__doc__)
    parser.add_argument("problems", nargs="*", metavar="PROBLEM")
    asked = parser.parse_args().problems or names()
    for name in [spec(name).name for name in asked]:
        with TemporaryDirectory() as room, styled():
            rows = list(of_problem(name, Path(room)))
        store(name, rows)
        for row in rows:
            print(*row, sep="  ", flush=True)


if __name__ == "__main__":
    main()
