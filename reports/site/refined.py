"""Cost over the step size, planned and replayed at half of it: ``make refined``.

``python -m reports.site.refined [PROBLEM...]`` refines those problems, files too, and keeps the
rows of others; without any it takes :data:`ALL`.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

from ocp.judges.referee import step_place
from problems import get, names
from reports.site import measured
from reports.site.verdicts import Row, digits, told

LIMIT_S = 3600
"""Seconds of processor time that the refining of a problem may take."""
ALL = [name for name in names() if not step_place(get(name).system)[0]]
"""The named problems whose h only discretises, and an arm at a wall."""
ALL += ["examples/double_pendulum_walls.py"]


def of_problem(asked: str, room: str) -> Iterator[Row]:
    """Rows of one problem, a step size after the other, and how it ended at the last."""
    words = ["solve", asked, "--contact", "exact", "--refine", "--out", room]
    found, name = told(words, LIMIT_S), Path(asked).stem
    if isinstance(found, str):
        yield [name, *[None] * 4, found]
        return
    levels = found["refined"]["levels"]
    for one in levels:
        end = (found["refined"]["stopped"] or "agree") if one is levels[-1] else ""
        costs = digits(one["cost"]), digits(one["replayed"])
        yield [name, f"{one['h']:.5g}", one["N"], *costs, end]


def main() -> None:
    """Measure the problems that the command line names, all where it names none."""
    order = [Path(name).stem for name in ALL]
    for asked in sys.argv[1:] or ALL:
        with TemporaryDirectory() as room:
            rows = list(of_problem(asked, room))
        known = (measured.DATA / "refined.json").exists()
        old = measured.read("refined")["rows"] if known else []
        rows += [row for row in old if row[0] != Path(asked).stem]
        measured.write_table(
            "refined",
            title="Cost over the step size",
            command="make refined",
            columns=("problem", "h [s]", "N", "planned", "replayed at h/2", "found"),
            rows=sorted(rows, key=lambda row: order.index(str(row[0]))),
            note="`ocp solve PROBLEM --contact exact --refine`: each plan starts at the one above"
            " it; the replay holds its inputs over two steps of half the size.",
        )


if __name__ == "__main__":
    main()
