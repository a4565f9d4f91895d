"""Solve every named problem under every law, for the pages of the gallery; ``make verdicts``.

``python -m reports.site.verdicts [PROBLEM...]`` measures those problems, keeps the rows of others,
and draws each exact optimum to ``docs/pictures/problems/<name>.png``. Learned laws are trained on
transitions that ``ocp collect`` draws first.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
from argparse import ArgumentParser
from collections.abc import Iterator, Sequence
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
_OCP = (sys.executable, "-c", "import sys; from reports.cli.app import main; sys.exit(main())")

Row = list[measured.Cell]


def of_problem(name: str, room: Path) -> Iterator[Row]:
    """Rows of one problem, a law after the other; what is made on the way lies in ``room``."""
    for law, words in ANALYTIC.items():
        yield solved(name, law, words, room)
    data = room / "data.nc"
    if told(["collect", name, "--samples", SAMPLES, "-o", str(data)]) is None:
        yield from ([name, law, "no transitions", *[None] * 5] for law in LEARNED)
        return
    for law, model in LEARNED.items():
        file = room / f"{model}.nc"
        learned = told(["learn", str(data), "--model", model, "--noise", "0.1", "-o", str(file)])
        if learned is None:
            yield [name, law, f"not learned in {LIMIT_S} s", *[None] * 5]
        else:
            yield solved(name, law, (model, "-c", f"model={file}"), room)


def solved(name: str, law: str, words: Sequence[str], room: Path) -> Row:
    """Solve under one law; a solve that takes longer than :data:`LIMIT_S` has no numbers."""
    found = told(["solve", name, "--contact", *words, "--out", str(room / "runs")])
    if found is None:
        return [name, law, f"over {LIMIT_S} s", *[None] * 5]
    if law == "exact":
        draw(name, Path(found["run"]))
    costs = (found["cost"], found["exact_cost"], found["referee_cost"])
    seconds = f"{found['build_s'] + found['solve_s']:.2g}"
    return [name, law, verdict(found), *map(digits, costs), found["iterations"], seconds]


def verdict(found: dict[str, Any]) -> str:
    """Say in words what certificate and referee found."""
    if not found["success"]:
        return str(found["status"])
    said = {True: "survives", False: "does not survive", None: "no referee"}
    return f"solved, {said[found['survives']]}"


def digits(value: float | None) -> str | None:
    """Write a cost as verdicts do."""
    return None if value is None else f"{value:.6g}"


def told(words: Sequence[str]) -> Any:
    """Return the JSON document that ``ocp`` prints, None where it takes too long or refuses."""
    command = [*_OCP, *words, "--json", "--quiet"]
    try:
        return json.loads(
            subprocess.run(command, capture_output=True, text=True, preexec_fn=_limited).stdout
        )
    except json.JSONDecodeError:
        return None


def _limited() -> None:
    resource.setrlimit(resource.RLIMIT_CPU, (LIMIT_S, LIMIT_S))


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
