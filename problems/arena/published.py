"""Instances of arena tasks as their sources drew them, and the results that were published for them."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, ClassVar

from pydantic import model_validator

from problems.parameters import Parameters, structure

DATA = Path(__file__).parent / "data"
"""Folder with a CSV file for each task: a row per instance, with parameters and, per solver, columns SOLVER.NAME."""
INSTANCE_COUNT = 100
"""Number of instances in each file."""


@cache
def _rows(task: str) -> tuple[dict[str, str], ...]:
    with (DATA / f"{task}.csv").open(newline="") as file:
        return tuple(csv.DictReader(file))


def instance_parameters(task: str, number: int = 1) -> dict[str, float]:
    """Return the parameters of an instance, counted from 1."""
    columns = _rows(task)[number - 1]
    return {name: float(text) for name, text in columns.items() if name != "instance" and "." not in name}


@dataclass(frozen=True)
class PublishedResult:
    """Result of a solver on one instance, as published.

    ``violation`` is the largest residual of the solver's own formulation, ``wall_ms`` the wall-clock time [ms] on the
    source's computer (None if it was not published).
    """

    solver: str
    instance: int
    solved: bool
    iterations: int
    cost: float
    violation: float
    wall_ms: float | None


def published_results(task: str) -> list[PublishedResult]:
    """Return all published results of a task, solver by solver; empty if none are stored."""
    if not (DATA / f"{task}.csv").exists():
        return []
    rows = _rows(task)
    solvers = [name.removesuffix(".cost") for name in rows[0] if name.endswith(".cost")]
    return [_result(solver, row) for solver in solvers for row in rows]


def _result(solver: str, row: dict[str, str]) -> PublishedResult:
    wall_ms = row.get(f"{solver}.wall_ms")
    return PublishedResult(
        solver,
        int(row["instance"]),
        row[f"{solver}.solved"] == "1",
        int(row[f"{solver}.iterations"]),
        float(row[f"{solver}.cost"]),
        float(row[f"{solver}.violation"]),
        None if wall_ms is None else float(wall_ms),
    )


def workbench_results(task: str) -> list[PublishedResult]:
    """Return the results of ``ocp solve`` on a task, as ``make arena`` measured them; 0 is a task without instances."""
    rows = [row for row in _rows("workbench") if row["task"] == task]
    return [_result("ocp", row) for row in rows]


class InstanceParameters(Parameters):
    """Parameters of a task with published instances; the numbers of an instance are defaults of other parameters."""

    TASK: ClassVar[str]
    """Name of the task, and of its file."""

    instance: int = structure(1, "number of the published instance", least=1, most=INSTANCE_COUNT)

    @model_validator(mode="before")
    @classmethod
    def _with_instance(cls, values: Any) -> Any:
        number = values.get("instance", 1)
        if number not in range(1, INSTANCE_COUNT + 1):
            return values
        return {**instance_parameters(cls.TASK, int(number)), **values}
