"""``ocp arena compare FILE``: results on arena tasks beside those of the workbench and of the tasks' sources."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError

from ocp.errors import InputError, choose
from ocp.validation import expand_path
from problems.arena.published import INSTANCE_COUNT, published_results, workbench_results
from problems.registry import ARENA_MODULES
from reports.cli.options.output import CompareOptions
from reports.tables.console import number, print_table, table_of

EQUAL_SHARE = 1e-4
"""Relative difference up to which two costs count as equal."""


COLUMNS = ("task", ">solved", ">cost", ">ocp solve", ">lower", ">equal", ">higher", ">published")
"""Columns of the table; costs are medians, those of published results of the best solver per instance."""


class ResultRow(BaseModel):
    """One row of the file: task, instance (0 for a task without instances), cost [the task's unit], and its effort."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, frozen=True)

    task: str
    cost: float
    instance: int = 0
    solved: bool = True
    iterations: int | None = None
    seconds: float | None = None


def check_compare(options: CompareOptions) -> list[ResultRow]:
    """Return the rows of the file; raise InputError with the line of the first that is wrong."""
    file = expand_path(options.file)
    try:
        lines = list(csv.DictReader(file.read_text(encoding="utf-8-sig").splitlines(), strict=True))
    except (OSError, UnicodeError, csv.Error) as error:
        raise InputError(f"{file} cannot be read as CSV: {error}") from None
    if not lines:
        raise InputError(f"{file} has no results; expected a header with task, instance, cost and a line for each")
    rows = [_read_row(file, number, line) for number, line in enumerate(lines, 2)]
    keys = [(row.task, row.instance) for row in rows]
    if twice := [key for key in keys if keys.count(key) > 1]:
        raise InputError(f"{file} has instance {twice[0][1]} of {twice[0][0]} twice; leave one of them out")
    return rows


def _read_row(file: Path, line_number: int, line: dict[Any, Any]) -> ResultRow:
    place = f"{file}, line {line_number}"
    if None in line or None in line.values():
        raise InputError(
            f"{place} has more or fewer cells than the header; give each column a cell, which may be empty"
        )
    try:
        row = ResultRow.model_validate({name.strip(): text.strip() for name, text in line.items() if text.strip()})
    except ValidationError as error:
        details = error.errors()[0]
        columns = ", ".join(ResultRow.model_fields)
        raise InputError(f"{place}: {details['loc'][0]}: {details['msg']}; the columns are {columns}") from None
    choose("arena task", row.task, ARENA_MODULES)
    first, last = (1, INSTANCE_COUNT) if published_results(row.task) else (0, 0)
    if not first <= row.instance <= last:
        raise InputError(f"{place}: instance of {row.task} must be from {first} to {last}, got {row.instance}")
    return row


def run_compare(options: CompareOptions, rows: Sequence[ResultRow]) -> int:
    """Print a row for each task, or the comparison of each instance as JSON."""
    comparisons = [_comparison(row) for row in rows]
    options.output.document({"results": comparisons})
    if not options.as_json:
        tasks = dict.fromkeys(row.task for row in rows)
        print_table(table_of(*COLUMNS, rows=[_task_cells(task, comparisons) for task in tasks]))
    return 0


def _comparison(row: ResultRow) -> dict[str, Any]:
    """Return a result beside the costs that are known for its instance (None: not known)."""
    ours = [known.cost for known in workbench_results(row.task) if known.instance == row.instance and known.solved]
    known = [result for result in published_results(row.task) if result.instance == row.instance and result.solved]
    best = min(known, key=lambda result: result.cost, default=None)
    return {
        **row.model_dump(),
        "workbench_cost": ours[0] if ours else None,
        "published_cost": best.cost if best else None,
        "published_solver": best.solver if best else None,
    }


def _task_cells(task: str, comparisons: Sequence[dict[str, Any]]) -> list[str]:
    entries = [entry for entry in comparisons if entry["task"] == task]
    solved = [entry for entry in entries if entry["solved"]]
    compared = [(entry["cost"], entry["workbench_cost"]) for entry in solved if entry["workbench_cost"] is not None]
    excess = [(cost - ours) / max(abs(ours), 1e-12) for cost, ours in compared]
    counts = [sum(e < -EQUAL_SHARE for e in excess), sum(abs(e) <= EQUAL_SHARE for e in excess)]
    medians = [
        number(median(costs), 5) if costs else "–"
        for costs in (
            [entry["cost"] for entry in solved],
            [ours for _, ours in compared],
            [entry["published_cost"] for entry in entries if entry["published_cost"] is not None],
        )
    ]
    tallies = [str(count) for count in (*counts, len(excess) - sum(counts))]
    return [task, f"{len(solved)} of {len(entries)}", *medians[:2], *tallies, medians[2]]
