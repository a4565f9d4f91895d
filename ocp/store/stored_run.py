"""A stored run read back: arrays and records, and its numbers as CSV and NPZ for other programs."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ocp.errors import DamagedRun, InputError
from ocp.judge.audit import Audit
from ocp.judge.certificate import Certificate
from ocp.judge.referee import RefereeReport
from ocp.judge.route_report import RouteReport
from ocp.problem.problem import Problem
from ocp.problem.rollout import Gains
from ocp.programs.solver import Status
from ocp.routes.homotopy import StageRecord
from ocp.solution import Solution
from ocp.store import atomic
from ocp.store.json_values import from_json
from ocp.store.meta import check_own_problem
from ocp.store.route_record import ADDED, route_from_record
from ocp.store.run_files import META_FILE, PROBLEM_FILE, parsed

if TYPE_CHECKING:
    import xarray as xr


@dataclass(frozen=True)
class StoredRun:
    """A run read back: labelled arrays, and everything else as plain JSON values.

    ``parts`` are its other files, in bytes, by name.
    ``meta`` holds ``schema kind problem created argv versions revision seed hash parts checksum``,
    of types that :mod:`ocp.store.meta` tells, and
    for ``kind == "solve"``, ``record audit certificate referee idle_cost cost status verdict grade
    stages iterations build_s solve_s others``.
    """

    path: Path
    data: xr.Dataset
    meta: dict[str, Any]
    parts: Mapping[str, bytes] = field(default_factory=dict)

    @property
    def kind(self) -> str:
        """What made it: ``solve``, ``continue``, ..."""
        return self.meta["kind"]

    @property
    def record(self) -> dict[str, Any]:
        """What was asked."""
        return self.meta.get("record") or {}

    @cached_property
    def own_problem(self) -> dict[str, Any] | None:
        """What it keeps of a problem of a user's file (:class:`~ocp.store.meta.OwnProblem`).

        None where it keeps nothing; raises as :attr:`audit` does.
        """
        if PROBLEM_FILE not in self.parts:
            return None
        file = self.path / PROBLEM_FILE
        told = parsed(file, self.parts[PROBLEM_FILE])
        check_own_problem(file, told)
        return told

    @cached_property
    def status(self) -> Status:
        """Outcome of the solve; raises as :attr:`audit` does."""
        return self._described(Status, "status")

    @cached_property
    def audit(self) -> Audit:
        """Audit of the solve; numbers that were not finite are NaN.

        Raises :class:`~ocp.errors.DamagedRun` where ``meta.json`` lacks a part of it.
        """
        return self._described(Audit, "audit")

    @cached_property
    def certificate(self) -> Certificate:
        """Certificate of the solve; raises as :attr:`audit` does."""
        return self._described(Certificate, "certificate")

    @cached_property
    def referee(self) -> RefereeReport:
        """What the referee found; raises as :attr:`audit` does."""
        return self._described(RefereeReport, "referee")

    @cached_property
    def stages(self) -> list[StageRecord]:
        """Homotopy table of the solve; raises as :attr:`audit` does."""
        return self._described(list[StageRecord], "stages")

    def solution(self, problem: Problem) -> Solution:
        """Return the solution as it was solved, of ``problem`` built again at its parameters.

        Its ``values`` are the problem's alone: a replay takes the parameters of its own law.

        Raises :class:`~ocp.errors.DamagedRun` where ``meta.json`` lacks a part of it, and
        :class:`~ocp.errors.InputError` for a run that is no solve.
        """
        self.check_solve()
        route, record = self._route()
        data, numbers = self.data, ("cost", "idle_cost", "build_s", "solve_s", "evaluation_s")
        kept = ("status", "audit", "certificate", "referee", "stages")
        return Solution(
            data=data,
            iterations=self._described(int, "iterations"),
            problem=problem,
            values=problem.parameters.defaults,
            gains=Gains(data["K"].values, data["k"].values) if "K" in data else None,
            route=route,
            run_hash=self.meta["hash"],
            **{name: record.pop(key) for name, key in ADDED.items() if key in record},
            record=record,
            **{name: getattr(self, name) for name in kept},
            **{name: self._described(float, name) for name in numbers},
        )

    def _route(self) -> tuple[RouteReport, dict[str, Any]]:
        try:
            return route_from_record(self.record, self.meta["others"])
        except (KeyError, ValueError) as error:
            raise DamagedRun(f"{self.path / META_FILE}: the route's description is damaged ({error})") from error

    def check_solve(self) -> None:
        """Raise :class:`~ocp.errors.InputError` unless the run is one of ``ocp solve``."""
        if self.kind != "solve":
            hints = {"train": "; ocp evaluate judges a policy", "figure": "; ocp report shows it"}
            command = {"closed-loop": "mpc"}.get(self.kind, self.kind)
            raise InputError(
                f"{self.path} is a run of ocp {command}, expected a run of ocp solve{hints.get(self.kind, '')}"
            )

    def _described(self, kind: Any, key: str) -> Any:
        try:
            return from_json(kind, self.meta[key])
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise DamagedRun(
                f"{self.path / META_FILE}: the solution's description is incomplete ({error!r})"
            ) from error


ROWS = {
    "solve": ("scenario", "node"),
    "continue": ("point", "scenario", "node"),
    "estimate": ("point", "estimator"),
    "train": ("iteration",),
    "closed-loop": ("seed", "node"),
}
"""Dimensions that a CSV has a row for, by the kind of a run; intervals and samples are nodes but
the last."""


def rows_of(run: StoredRun) -> tuple[str, ...] | None:
    """Dimensions that the run's CSV has a row for, None where it makes no one table."""
    if run.kind == "sweep":
        return tuple(axis["name"] for axis in run.meta["study"]["axes"])
    return ROWS.get(run.kind)


def check_rows(run: StoredRun) -> None:
    """Raise :class:`~ocp.errors.InputError` for a kind of run that makes no one table."""
    if rows_of(run) is None:
        raise InputError(f"{run.path} holds a {run.kind}, whose arrays make no one table; take --format npz")


def write_csv(run: StoredRun, file: Path) -> None:
    """Write the arrays over :data:`ROWS` as one table, units in the head; raises as the store does.

    Numbers keep all their digits; where an array has no value, as an input at the last node, the
    cell is empty. A text that a spreadsheet would run as a formula begins with a quote.
    """
    check_rows(run)
    heads, columns = zip(*_columns(run), strict=True)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(map(_text, heads))
    writer.writerows(zip(*(map(_cell, column) for column in columns), strict=True))
    atomic.write(file, text.getvalue().encode(), "the data to")


def write_npz(run: StoredRun, file: Path) -> None:
    """Write every array and coordinate by name, and the description as JSON in ``meta``."""
    values = {str(name): run.data[name].values for name in run.data.variables}
    # Objects would be pickled.
    arrays: dict[str, Any] = {
        name: each.astype(str) if each.dtype.kind == "O" else each for name, each in values.items()
    }
    content = io.BytesIO()
    np.savez_compressed(content, meta=np.array(json.dumps(run.meta)), **arrays)
    atomic.write(file, content.getvalue(), "the data to")


FORMATS: dict[str, Callable[[StoredRun, Path], None]] = {"csv": write_csv, "npz": write_npz}


def _cell(value: Any) -> str:
    if isinstance(value, float | np.floating):
        return "" if np.isnan(value) else repr(float(value))
    return _text(value) if isinstance(value, str) else str(value)


def _text(value: str) -> str:
    """A quote before what spreadsheets would run as a formula."""
    return f"'{value}" if value[:1] in set("=+-@\t\r") else value


def _columns(run: StoredRun) -> Iterator[tuple[str, list[Any]]]:
    """Head and cells of each column: first what the rows are, then every array over them."""
    data, rows = run.data, rows_of(run) or ()
    shape = tuple(data.sizes[name] for name in rows)
    for place, name in enumerate(rows):
        labels = data[name].values if name in data.coords else np.arange(shape[place])
        others = [axis for axis in range(len(rows)) if axis != place]
        within = np.broadcast_to(np.expand_dims(labels, others), shape)
        yield name, list(within.ravel())
    for name in map(str, [*data.coords, *data.data_vars]):
        if name not in rows and not name.startswith(("lam_g_", "lam_x_", "time_interval")):
            yield from _of_array(data, name, rows, shape)


def _of_array(data: Any, name: str, rows: tuple[str, ...], shape: tuple[int, ...]) -> Iterator[tuple[str, list[Any]]]:
    """Columns of one array, a label each; none of an array that is not over the rows."""
    array = data[name]
    step = next((one for one in ("interval", "sample") if one in array.dims), None)
    if step is not None and "node" in rows:
        after = data.sizes["node"] - data.sizes[step]
        array = array.pad({step: (0, after)}).rename({step: "node"})
    along = [one for one in rows if one in array.dims]
    across = [one for one in array.dims if one not in rows]
    if not along or len(across) > 1:
        return
    values = array.transpose(*along, *across).values
    missing = tuple(place for place, one in enumerate(rows) if one not in along)
    values = np.expand_dims(values, missing)
    values = np.broadcast_to(values, (*shape, *values.shape[len(rows) :]))
    labels = _labels(data, across[0]) if across else [("", "")]
    for place, (label, own) in enumerate(labels):
        cells = values[..., place] if across else values
        unit = own if array.attrs.get("units", "").startswith("see ") else array.attrs.get("units")
        head = f"{name}.{label}" if label else name
        yield f"{head} [{unit}]" if unit and unit != "1" else head, list(cells.ravel())


def _labels(data: Any, dimension: str) -> list[tuple[str, str]]:
    """Label and unit of every place along a dimension."""
    count = data.sizes[dimension]
    names = data[dimension].values if dimension in data.coords else range(count)
    unit = f"{dimension}_unit"
    units = data[unit].values if unit in data.variables else [""] * count
    return [(str(name), str(one)) for name, one in zip(names, units, strict=True)]
