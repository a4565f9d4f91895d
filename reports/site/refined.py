"""Cost over the step size, planned and replayed at half of it: ``make refined``.

``python -m reports.site.refined [PROBLEM...]`` refines those problems, files too, and keeps the
rows of others; without any it takes every named one whose h only discretises.
"""

from __future__ import annotations

from argparse import ArgumentParser
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from ocp.judges.referee import step_place
from problems import get, names
from reports.site import measured
from reports.site.verdicts import Row, digits, told

LIMIT_S = 900
"""Seconds of processor time that the refining of a problem may take."""
ARM = "examples/double_pendulum_walls.py"
COLUMNS = ("problem", "h [s]", "N", "planned", "replayed at h/2", "found")


def of_problem(name: str, room: Path) -> list[Row]:
    """Rows of one problem, a step size after the other, and how it ended at the last."""
    words = ["solve", name, "--contact", "exact", "--refine", "--out", str(room)]
    found, own = told(words, LIMIT_S), Path(name).stem
    if isinstance(found, str):
        return [[own, *[None] * 4, found]]
    levels, stopped = found["refined"]["levels"], found["refined"]["stopped"]
    return [[own, *_of_level(one), ""] for one in levels[:-1]] + [
        [own, *_of_level(levels[-1]), stopped or "agree"]
    ]


def _of_level(one: dict[str, Any]) -> Row:
    return [f"{one['h']:.5g}", one["N"], digits(one["cost"]), digits(one["replayed"])]


def store(name: str, rows: list[Row]) -> None:
    """Put the rows of one problem into the table, in the order of the registry."""
    file = measured.DATA / "refined.json"
    old = measured.read("refined")["rows"] if file.exists() else []
    order = [*names(), Path(ARM).stem]
    every = [*(row for row in old if row[0] != name), *rows]
    measured.write_table(
        "refined",
        title="Cost over the step size",
        command="make refined",
        columns=COLUMNS,
        rows=sorted(every, key=lambda row: order.index(str(row[0]))),
        note="`ocp solve PROBLEM --contact exact --refine`: each plan starts at the one above it;"
        " the replay holds its inputs over two steps of half the size.",
    )


def main() -> None:
    """Measure the problems that the command line names, all where it names none."""
    parser = ArgumentParser(prog="python -m reports.site.refined", description=__doc__)
    parser.add_argument("problems", nargs="*", metavar="PROBLEM")
    every = [name for name in names() if not step_place(get(name).system)[0]]
    for name in parser.parse_args().problems or [*every, ARM]:
        with TemporaryDirectory() as room:
            rows = of_problem(name, Path(room))
        store(Path(name).stem, rows)
        for row in rows:
            print(*row, sep="  ", flush=True)


if __name__ == "__main__":
    main()
