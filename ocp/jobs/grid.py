"""Grid of a sweep's points: axes, checkpoints of finished points, and the dataset of all results."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ocp.errors import InputError
from ocp.jobs.sweep_job import (
    ROW_COUNTS,
    ROW_NUMBERS,
    ROW_TEXTS,
    STORED_ARRAYS,
    JobResult,
    LabelledArray,
    SolveJob,
)
from ocp.problem.resources import check_memory, points_memory
from ocp.routes.session import Session
from ocp.solve.request import ProblemSource
from ocp.solve.solve_request import SolveRequest
from ocp.solve.starts import Rank
from ocp.store.checkpoint import Checkpoint, SavedWork
from ocp.validation import AXIS_GRAMMAR, MAX_AXIS_VALUES, Axis, parse_axis_option

if TYPE_CHECKING:
    import xarray as xr


AXIS_DIGITS = 12
"""Number of significant digits of axis values, so that 0.3 is exactly 0.3 and can be selected."""


def parse_axes(over: Mapping[str, Any] | Iterable[str | Axis]) -> tuple[Axis, ...]:
    """Parse a grid's axes: texts as in :data:`AXIS_GRAMMAR`, or a mapping from names to arrays or ``"A:B:n"``.

    Raises :class:`~ocp.errors.InputError` if there is no axis, a name is repeated, a text does not follow the
    grammar, or there are more than :data:`MAX_AXIS_VALUES` points.
    """
    if isinstance(over, Mapping):
        parsed = [_axis_of_values(str(name), values) for name, values in over.items()]
    else:
        parsed = [axis_or_text if isinstance(axis_or_text, Axis) else parse_axis(axis_or_text) for axis_or_text in over]
    if not parsed:
        raise InputError(f"a sweep needs a parameter; give --over {AXIS_GRAMMAR}")
    names = [axis.name for axis in parsed]
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise InputError(f"--over: {repeated[0]} is given twice; give it once")
    count = math.prod(len(axis.values) for axis in parsed)
    if count > MAX_AXIS_VALUES:
        raise InputError(f"a grid of {count} points is more than {MAX_AXIS_VALUES}; take fewer values")
    return tuple(parsed)


def parse_axis(text: str) -> Axis:
    """Parse an axis such as ``M=0.5:2:7`` or ``contact.mu=1e-4:1:5:log``; raises the errors of :func:`parse_axes`."""
    parsed = parse_axis_option("--over", text, least_count=2)
    name, begin, end = parsed.name, parsed.values[0], parsed.values[-1]
    if begin == end:
        raise InputError(f"--over {name}: both ends are {begin:g}; give two that differ")
    values = tuple(float(f"{value:.{AXIS_DIGITS}g}") for value in parsed.values)
    if len(set(values)) < len(values):
        raise InputError(
            f"--over {name}: {len(values)} values between {begin:g} and {end:g} are"
            f" equal to {AXIS_DIGITS} digits; take fewer"
        )
    return Axis(name, values, parsed.log)


def _axis_of_values(name: str, values: Any) -> Axis:
    if isinstance(values, str):
        return parse_axis(f"{name}={values}")
    array = np.atleast_1d(np.asarray(values, dtype=float))
    if array.ndim != 1 or not array.size or not np.all(np.isfinite(array)):
        raise InputError(f"--over {name}: expected finite numbers in a row, got {values!r}")
    if len(set(array.tolist())) < array.size:
        raise InputError(f"--over {name}: a value is given twice; give each once")
    return Axis(name, tuple(array.tolist()), _is_geometric(array))


def _is_geometric(values: np.ndarray) -> bool:
    """Return whether ratios of successive values vary less than differences; False for fewer than three values."""
    if values.size < 3 or np.any(values <= 0):
        return False
    steps, ratios = np.diff(values), np.diff(np.log(values))
    return bool(np.ptp(ratios) / abs(ratios.mean()) < np.ptp(steps) / abs(steps.mean()))


ROW_UNITS = {"solve_s": "s", "seconds": "s", "penetration": "m"}
"""Mapping from names of a point's numbers to their units; all other numbers are dimensionless."""
SECONDS = "seconds"
"""Name of a point's total time [s]."""
GAIN_NAMES = {"K": "gain_K", "k": "gain_k"}
"""Mapping from K and k to their names in a dataset, in which parameters may have the names K and k."""
_DIMENSIONS = ("scenario", "node", "interval", "state", "control", "contact", "contact_exact")
"""Dimensions of a point's trajectories in a dataset."""
DATASET_NAMES = {
    *(*_DIMENSIONS, "time", SECONDS, *ROW_NUMBERS, *ROW_TEXTS, *ROW_COUNTS),
    *(name for name in STORED_ARRAYS if name not in GAIN_NAMES),
}
"""Names of variables and dimensions in a sweep's dataset, which cannot be names of an axis."""


@dataclass(frozen=True)
class Grid:
    """Grid of solves: a request at all combinations of the axes' values.

    Axes have full names as in :class:`~ocp.solve.solve_request.SolveRequest`. ``starts``, ``seed``
    and ``rank`` are the number of guesses, the seed and the ranking of every solve.
    """

    request: SolveRequest
    axes: tuple[Axis, ...]
    starts: int = 1
    seed: int = 0
    rank: Rank = "planned"

    @cached_property
    def source(self) -> ProblemSource:
        """Source that builds the problem, read at the first access."""
        return self.request.source()

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of values along each axis."""
        return tuple(len(axis.values) for axis in self.axes)

    @property
    def point_values(self) -> list[dict[str, float]]:
        """List of mappings from full names to values, one for each point; the last axis varies fastest."""
        names = [axis.name for axis in self.axes]
        values = itertools.product(*(axis.values for axis in self.axes))
        return [dict(zip(names, combination, strict=True)) for combination in values]

    def structure_key(self, values: Mapping[str, float]) -> tuple[float, ...]:
        """Return the values at a point that change the structure of its program: settings and integer parameters."""
        fields = self.source.Params.model_fields

        def is_integer(name: str) -> bool:
            return fields[name.removeprefix("problem.")].annotation is int

        return tuple(
            value
            for name, value in values.items()
            if name.startswith(("setting.", "policy.")) or (name.startswith("problem.") and is_integer(name))
        )

    def job(self, values: Mapping[str, float], start: JobResult | None = None) -> SolveJob:
        """Return the job that solves the point with ``values``, from the plan of ``start`` if given."""
        return SolveJob(self.request.at(values), self.starts, self.seed, self.rank, start=start)

    def neighbours(self, index: int) -> list[int]:
        """Return the indices of the points that are one step along an axis from the point ``index``."""
        coordinates, neighbours = np.unravel_index(index, self.shape), list[int]()
        for axis, size in enumerate(self.shape):
            for shifted in (coordinates[axis] - 1, coordinates[axis] + 1):
                if 0 <= shifted < size:
                    neighbour = (*coordinates[:axis], shifted, *coordinates[axis + 1 :])
                    neighbours.append(int(np.ravel_multi_index(neighbour, self.shape)))
        return neighbours

    def check(self, jobs: int = 1) -> Session:
        """Check that every value is valid at some point and that memory suffices; return a session of a valid point.

        Raises :class:`~ocp.errors.InputError` if a value is valid at no point, or if ``jobs`` simultaneous solves,
        or the results of all points, need too much memory.
        """
        source = self.source
        refused: dict[tuple[str, float], InputError] = {}
        accepted: set[tuple[str, float]] = set()
        for values in self.point_values:
            try:
                source.params(self.request.at(values).params)
                accepted |= set(values.items())
            except InputError as error:
                refused |= {item: error for item in values.items() if item not in refused}
        for item, error in refused.items():
            if item not in accepted:
                raise error
        first = self.request.at(next(values for values in self.point_values if set(values.items()) <= accepted))
        for axis in self.axes:
            for value in axis.values[:: max(1, len(axis.values) - 1)]:
                if not axis.name.startswith("problem."):
                    first.at({axis.name: value}).session(source)
        session = first.session(source)
        check_memory(f"{jobs} solves in parallel", jobs * session.memory)
        count = math.prod(self.shape)
        # Trajectories of points with smaller N are padded to the longest.
        longest = math.prod(
            max(axis.values) / axis.values[0] for axis in self.axes if axis.name in ("problem.N", "problem.scenarios")
        )
        check_memory(f"a grid of {count} points", points_memory(session.problem, count, longest))
        return session

    def checkpoint(self, root: Path | None, name: str) -> Checkpoint:
        """Return the checkpoint of this grid in the store ``root``; a change of the user's files gives another."""
        description = {
            "case": {**vars(self.request), "content": None},
            "axes": [vars(axis) for axis in self.axes],
            "starts": self.starts,
            "seed": self.seed,
            "rank": self.rank,
        }
        return Checkpoint(root, name, {"sweep": description}, self.request.content or "")


def dimension_name(name: str) -> str:
    """Return the name of the dataset's dimension for an axis's full name, such as ``M`` or ``contact.mu``."""
    short = name.removeprefix("problem.")
    return name if short in DATASET_NAMES else short


def grid_dataset(study: Grid, session: Session, points: Sequence[JobResult]) -> xr.Dataset:
    """Return all points as a dataset; each array has the dimensions of the axes, followed by those of its trajectories.

    If trajectories differ in size, as in a sweep over N, shorter trajectories are padded with NaN.
    """
    import xarray as xr

    dims = [dimension_name(axis.name) for axis in study.axes]
    data: dict[str, Any] = {}
    for name in (*ROW_NUMBERS, SECONDS, *ROW_COUNTS, *ROW_TEXTS):
        kind = {**dict.fromkeys(ROW_COUNTS, int), **dict.fromkeys(ROW_TEXTS, object)}.get(name, float)
        values = np.array([point.row[name] for point in points], dtype=kind).reshape(study.shape)
        data[name] = (dims, values, {"units": ROW_UNITS.get(name, "1")})
    for name in ("success", "survives"):
        data[name][2]["meaning"] = "1 yes, 0 no, -1 unknown"
    sizes = _dimension_sizes(points)
    for name in dict.fromkeys(name for point in points for name in point.arrays):
        stacked = _stack_array(name, study.shape, sizes, points)
        units = {"units": "s" if name == "time" else "see units of the problem's signals"}
        data[GAIN_NAMES.get(name, name)] = ((*dims, *stacked.dims), stacked.values, units)
    coordinates: dict[str, Any] = {
        dim: (dim, list(axis.values), {"units": _axis_unit(session, axis.name)})
        for dim, axis in zip(dims, study.axes, strict=True)
    }
    labelled = {dim: labels for dim, labels in sizes.items() if isinstance(labels, list)}
    return xr.Dataset(data, coords={**coordinates, **labelled})


def _axis_unit(session: Session, name: str) -> str:
    short = name.removeprefix("problem.")
    table = session.problem.parameters + session.step.p
    return table.get(short).unit if short in table else "1"


def _dimension_sizes(points: Iterable[JobResult]) -> dict[str, int | list[str]]:
    """Return a mapping from each dimension to its largest size over all points or, if labelled, to all labels."""
    counts: dict[str, int] = {}
    labels: dict[str, list[str]] = {}
    for array in (array for point in points for array in point.arrays.values()):
        for dim, size in zip(array.dims, array.values.shape, strict=True):
            seen_labels = labels.setdefault(dim, [])
            seen_labels += [label for label in array.labels.get(dim, ()) if label not in seen_labels]
            counts[dim] = max(counts.get(dim, 0), size)
    return {dim: labels[dim] or count for dim, count in counts.items()}


def _stack_array(
    name: str,
    shape: tuple[int, ...],
    sizes: Mapping[str, int | list[str]],
    points: Sequence[JobResult],
) -> LabelledArray:
    dims = next(point.arrays[name].dims for point in points if name in point.arrays)
    ends = [size if isinstance(size := sizes[dim], int) else len(size) for dim in dims]
    values = np.full((math.prod(shape), *ends), np.nan)
    for index, point in enumerate(points):
        if name not in point.arrays:
            continue
        array = point.arrays[name]
        indices = [
            np.arange(size)
            if isinstance(labels := sizes[dim], int)
            else [labels.index(label) for label in array.labels[dim]]
            for dim, size in zip(dims, array.values.shape, strict=True)
        ]
        values[index][np.ix_(*indices)] = array.values
    return LabelledArray(dims, values.reshape(*shape, *ends), {})


@dataclass(frozen=True)
class SavedPoints:
    """Storage of finished points under the numbers ``first``, ... (a :class:`~ocp.jobs.scheduling.SavedResults`)."""

    files: SavedWork
    first: int = 0

    def load(self, index: int) -> JobResult | None:
        """Return the result of the point ``index``, or None if it is not finished."""
        rows = self.files.rows(self.first + index)
        if rows is None:
            return None
        layout = json.loads(rows[0]["arrays"])
        values = self.files.state(self._array_key(index)) if layout else {}
        if values is None or set(values) != set(layout):
            return None
        arrays = {name: LabelledArray(tuple(dims), values[name], labels) for name, (dims, labels) in layout.items()}
        return JobResult(rows[0]["row"], arrays)

    def save(self, index: int, point: JobResult) -> JobResult:
        """Save and return a point; its row is written last, so that the arrays are complete if there is a row."""
        layout = {name: [array.dims, dict(array.labels)] for name, array in point.arrays.items()}
        if point.arrays:
            arrays = {name: array.values for name, array in point.arrays.items()}
            self.files.save_state(self._array_key(index), **arrays)
        self.files.save_rows(self.first + index, [{"row": point.row, "arrays": json.dumps(layout)}])
        return point

    def _array_key(self, index: int) -> str:
        return f"arrays-{self.first + index:05d}"


def load_points(study: Grid, files: SavedWork) -> dict[int, JobResult]:
    """Return a mapping from grid indices to the results of the points that are finished in ``files``."""
    points = ((index, SavedPoints(files).load(index)) for index in range(math.prod(study.shape)))
    return {index: point for index, point in points if point is not None}
