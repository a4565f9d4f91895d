"""Stored runs: their arrays and records, and export as CSV and NPZ."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ocp.errors import DamagedRun, InputError
from ocp.judge.audit import Audit
from ocp.judge.certificate import Certificate
from ocp.judge.referee import RefereeReport
from ocp.judge.route_report import RouteReport
from ocp.labelled import LabelledArrays
from ocp.problem.evaluation import Evaluation
from ocp.problem.problem import Problem
from ocp.problem.rollout import Gains
from ocp.programs.solver import Status
from ocp.routes.homotopy import StageRecord
from ocp.solution import Solution
from ocp.store import atomic
from ocp.store.json_values import from_json
from ocp.store.meta import check_own_problem
from ocp.store.route_record import ADDED, route_from_record
from ocp.store.run_files import META_FILE, PROBLEM_FILE, parse_json_object

if TYPE_CHECKING:
    import xarray as xr


@dataclass(frozen=True)
class StoredRun:
    """A stored run: labelled arrays, of which ``data`` is an xarray.Dataset, and all other values as JSON in ``meta``.

    ``parts`` maps names of the run's other files to their contents. ``meta`` contains ``schema kind problem
    created argv versions revision seed hash parts checksum``, with the types of :mod:`ocp.store.meta`, and if
    ``kind`` is ``solve`` also ``record audit certificate referee idle_cost cost status verdict grade stages
    iterations build_s solve_s others``.
    """

    path: Path
    arrays: LabelledArrays
    meta: dict[str, Any]
    parts: Mapping[str, bytes] = field(default_factory=dict)

    @property
    def data(self) -> xr.Dataset:
        """The arrays as an xarray.Dataset."""
        return self.arrays.dataset

    def with_data(self, data: xr.Dataset) -> StoredRun:
        """Return the run with other arrays."""
        return replace(self, arrays=LabelledArrays.of(data))

    @property
    def kind(self) -> str:
        """Kind of the run, such as ``solve`` or ``continue``."""
        return self.meta["kind"]

    @property
    def record(self) -> dict[str, Any]:
        """Record of the run's request, as a mapping."""
        return self.meta.get("record") or {}

    @cached_property
    def own_problem(self) -> dict[str, Any] | None:
        """Description of a user's problem (:class:`~ocp.store.meta.OwnProblem`); None for problems of the workbench.

        Raises the errors of :attr:`audit`.
        """
        if PROBLEM_FILE not in self.parts:
            return None
        file = self.path / PROBLEM_FILE
        description = parse_json_object(file, self.parts[PROBLEM_FILE])
        check_own_problem(file, description)
        return description

    @cached_property
    def status(self) -> Status:
        """Status with which the solve ended; raises the errors of :attr:`audit`."""
        return self._entry(Status, "status")

    @cached_property
    def audit(self) -> Audit:
        """Audit of the solve's solution, with NaN for numbers that were not finite.

        Raises :class:`~ocp.errors.DamagedRun` if entries are missing or invalid in ``meta.json``.
        """
        return self._entry(Audit, "audit")

    @cached_property
    def certificate(self) -> Certificate:
        """Certificate of the solve's solution; raises the errors of :attr:`audit`."""
        return self._entry(Certificate, "certificate")

    @cached_property
    def referee(self) -> RefereeReport:
        """Report of the referee on the solve's solution; raises the errors of :attr:`audit`."""
        return self._entry(RefereeReport, "referee")

    @cached_property
    def stages(self) -> list[StageRecord]:
        """Records of the homotopy stages of the solve; raises the errors of :attr:`audit`."""
        return self._entry(list[StageRecord], "stages")

    def solution(self, problem: Problem) -> Solution:
        """Return the run's solution; ``problem`` must be the run's problem, rebuilt with the run's parameters.

        The solution's ``values`` contain only the problem's parameters; the contact law of a replay has its own
        parameters.

        Raises :class:`~ocp.errors.DamagedRun` if entries are missing in ``meta.json``, and
        :class:`~ocp.errors.InputError` for a run that is not a solve.
        """
        self.check_solve()
        route, record = self._route()
        arrays, numbers = self.arrays, ("cost", "idle_cost", "build_s", "solve_s", "evaluation_s")
        attributes = ("status", "audit", "certificate", "referee", "stages")
        solution = Solution(
            arrays=arrays,
            iterations=self._entry(int, "iterations"),
            problem=problem,
            values=problem.parameters.defaults,
            gains=Gains(arrays["K"], arrays["k"]) if "K" in arrays else None,
            route=route,
            run_hash=self.meta["hash"],
            **{name: record.pop(key) for name, key in ADDED.items() if key in record},
            record=record,
            **{name: getattr(self, name) for name in attributes},
            **{name: self._entry(float, name) for name in numbers},
        )
        if not route.controller:
            return solution
        from ocp.mpc.plan_policies import ControllerPolicy

        return replace(solution, controller=ControllerPolicy(Evaluation(problem, solution.values)))

    @property
    def route(self) -> RouteReport:
        """Report on the route to the solution."""
        return self._route()[0]

    def _route(self) -> tuple[RouteReport, dict[str, Any]]:
        try:
            return route_from_record(self.record, self.meta["others"])
        except (KeyError, ValueError) as error:
            raise DamagedRun(f"{self.path / META_FILE}: the route's description is damaged ({error})") from error

    def check_solve(self) -> None:
        """Raise :class:`~ocp.errors.InputError` if the run is not from ``ocp solve``."""
        if self.kind != "solve":
            hints = {"train": "; ocp evaluate judges a policy", "figure": "; ocp report shows it"}
            command = {"closed-loop": "mpc"}.get(self.kind, self.kind)
            raise InputError(
                f"{self.path} is a run of ocp {command}, expected a run of ocp solve{hints.get(self.kind, '')}"
            )

    def _entry(self, kind: Any, key: str) -> Any:
        try:
            return from_json(kind, self.meta[key])
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise DamagedRun(
                f"{self.path / META_FILE}: the solution's description is incomplete ({error!r})"
            ) from error


CSV_ROW_DIMENSIONS = {
    "solve": ("scenario", "node"),
    "continue": ("point", "scenario", "node"),
    "estimate": ("point", "estimator"),
    "gradients": ("world", "amplitude"),
    "train": ("iteration",),
    "closed-loop": ("seed", "node"),
}
"""Mapping from kinds of runs to the dimensions of the rows of a CSV; intervals and samples count as nodes."""


def csv_row_dimensions(run: StoredRun) -> tuple[str, ...] | None:
    """Return the dimensions over which a run's CSV has rows, or None if its arrays do not fit one table."""
    if run.kind == "sweep":
        return tuple(axis["name"] for axis in run.meta["study"]["axes"])
    return CSV_ROW_DIMENSIONS.get(run.kind)


def check_csv_rows(run: StoredRun) -> None:
    """Raise :class:`~ocp.errors.InputError` for a run whose arrays do not fit one table."""
    if csv_row_dimensions(run) is None:
        raise InputError(f"{run.path} holds a {run.kind}, whose arrays make no one table; take --format npz")


def write_csv(run: StoredRun, file: Path) -> None:
    """Write a run's arrays over :data:`CSV_ROW_DIMENSIONS` to a CSV file, with units in its header.

    Numbers are written with all digits. Missing values, such as the input at the last node, are empty cells. A
    text that a spreadsheet would run as a formula is prefixed with a quote. Raises the errors of
    :func:`check_csv_rows` and :func:`~ocp.store.atomic.write_file`.
    """
    check_csv_rows(run)
    headers, columns = zip(*_csv_columns(run), strict=True)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(map(_escape_formula, headers))
    writer.writerows(zip(*(map(_csv_cell, column) for column in columns), strict=True))
    atomic.write_file(file, text.getvalue().encode(), "the data to")


def write_npz(run: StoredRun, file: Path) -> None:
    """Write all arrays and coordinates of a run to an NPZ file, and its description as JSON under ``meta``."""
    values = {str(name): run.data[name].values for name in run.data.variables}
    # Texts are converted, since NumPy would pickle objects.
    arrays: dict[str, Any] = {
        name: values.astype(str) if values.dtype.kind == "O" else values for name, values in values.items()
    }
    content = io.BytesIO()
    np.savez_compressed(content, meta=np.array(json.dumps(run.meta)), **arrays)
    atomic.write_file(file, content.getvalue(), "the data to")


EXPORT_FORMATS: dict[str, Callable[[StoredRun, Path], None]] = {"csv": write_csv, "npz": write_npz}
"""Mapping from formats to functions that export a run."""


def _csv_cell(value: Any) -> str:
    if isinstance(value, float | np.floating):
        return "" if np.isnan(value) else repr(float(value))
    return _escape_formula(value) if isinstance(value, str) else str(value)


def _escape_formula(value: str) -> str:
    """Prefix a text with a quote if a spreadsheet would run it as a formula."""
    return f"'{value}" if value[:1] in set("=+-@\t\r") else value


def _csv_columns(run: StoredRun) -> Iterator[tuple[str, list[Any]]]:
    """Yield header and cells of each CSV column: first the coordinates of the rows, then all arrays over rows."""
    data, row_dimensions = run.data, csv_row_dimensions(run) or ()
    shape = tuple(data.sizes[name] for name in row_dimensions)
    for position, name in enumerate(row_dimensions):
        labels = data[name].values if name in data.coords else np.arange(shape[position])
        row_axes = [axis for axis in range(len(row_dimensions)) if axis != position]
        cells = np.broadcast_to(np.expand_dims(labels, row_axes), shape)
        yield name, list(cells.ravel())
    for name in map(str, [*data.coords, *data.data_vars]):
        if name not in row_dimensions and not name.startswith(("lam_g_", "lam_x_", "time_interval")):
            yield from _array_columns(data, name, row_dimensions, shape)


def _array_columns(
    data: Any, name: str, row_dimensions: tuple[str, ...], shape: tuple[int, ...]
) -> Iterator[tuple[str, list[Any]]]:
    """Yield header and cells of an array's CSV columns, one per label; no column if the array does not fit the rows."""
    array = data[name]
    step = next((dimension for dimension in ("interval", "sample") if dimension in array.dims), None)
    if step is not None and "node" in row_dimensions:
        missing_steps = data.sizes["node"] - data.sizes[step]
        array = array.pad({step: (0, missing_steps)}).rename({step: "node"})
    row_axes = [dimension for dimension in row_dimensions if dimension in array.dims]
    label_axes = [dimension for dimension in array.dims if dimension not in row_dimensions]
    if not row_axes or len(label_axes) > 1:
        return
    values = array.transpose(*row_axes, *label_axes).values
    missing = tuple(position for position, dimension in enumerate(row_dimensions) if dimension not in row_axes)
    values = np.expand_dims(values, missing)
    values = np.broadcast_to(values, (*shape, *values.shape[len(row_dimensions) :]))
    labels = _labels_and_units(data, label_axes[0]) if label_axes else [("", "")]
    for position, (label, label_unit) in enumerate(labels):
        cells = values[..., position] if label_axes else values
        unit = label_unit if array.attrs.get("units", "").startswith("see ") else array.attrs.get("units")
        header = f"{name}.{label}" if label else name
        yield f"{header} [{unit}]" if unit and unit != "1" else header, list(cells.ravel())


def _labels_and_units(data: Any, dimension: str) -> list[tuple[str, str]]:
    """Return the label and unit of each entry along a dimension."""
    count = data.sizes[dimension]
    names = data[dimension].values if dimension in data.coords else range(count)
    unit = f"{dimension}_unit"
    units = data[unit].values if unit in data.variables else [""] * count
    return [(str(name), str(unit)) for name, unit in zip(names, units, strict=True)]
