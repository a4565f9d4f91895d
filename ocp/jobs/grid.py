"""A grid of points: its axes, what is kept of each point on the way, and one labelled dataset."""

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
from ocp.jobs.case import Case
from ocp.jobs.sweep_job import COUNTS, NUMBERS, WORDS, JobResult, LabelledArray, SolveJob
from ocp.routes.session import Session
from ocp.solve.request import ProblemSource
from ocp.solve.solve import Rank
from ocp.store.checkpoint import Checkpoint
from ocp.validation import GRAMMAR, MOST, Axis, spaced

if TYPE_CHECKING:
    import xarray as xr


_DIGITS = 12
"""Significant digits of a value, so that 0.3 is 0.3 and is found by that."""


def axes(over: Mapping[str, Any] | Iterable[str | Axis]) -> tuple[Axis, ...]:
    """Read axes: words of :data:`GRAMMAR`, or values by name, each an array or ``"A:B:n"``.

    Raises :class:`~ocp.errors.InputError` for none, a name twice, what does not read so, and more
    than :data:`MOST` points.
    """
    if isinstance(over, Mapping):
        found = [_of(str(name), values) for name, values in over.items()]
    else:
        found = [one if isinstance(one, Axis) else axis(one) for one in over]
    if not found:
        raise InputError(f"a sweep needs a parameter; give --over {GRAMMAR}")
    names = [one.name for one in found]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputError(f"--over: {twice[0]} is given twice; give it once")
    count = math.prod(len(one.values) for one in found)
    if count > MOST:
        raise InputError(f"a grid of {count} points is more than {MOST}; take fewer values")
    return tuple(found)


def axis(text: str) -> Axis:
    """Read ``M=0.5:2:7`` or ``contact.mu=1e-4:1e-1:4:log``; raises as :func:`axes` does."""
    found = spaced("--over", text, least=2)
    name, first, last = found.name, found.values[0], found.values[-1]
    if first == last:
        raise InputError(f"--over {name}: both ends are {first:g}; give two that differ")
    values = tuple(float(f"{value:.{_DIGITS}g}") for value in found.values)
    if len(set(values)) < len(values):
        raise InputError(
            f"--over {name}: {len(values)} values between {first:g} and {last:g} are"
            f" equal to {_DIGITS} digits; take fewer"
        )
    return Axis(name, values, found.log)


def _of(name: str, values: Any) -> Axis:
    if isinstance(values, str):
        return axis(f"{name}={values}")
    given = np.atleast_1d(np.asarray(values, dtype=float))
    if given.ndim != 1 or not given.size or not np.all(np.isfinite(given)):
        raise InputError(f"--over {name}: expected finite numbers in a row, got {values!r}")
    if len(set(given.tolist())) < given.size:
        raise InputError(f"--over {name}: a value is given twice; give each once")
    return Axis(name, tuple(given.tolist()), _ratios(given))


def _ratios(values: np.ndarray) -> bool:
    """Whether more than two values stand in equal ratios rather than in equal steps."""
    if values.size < 3 or np.any(values <= 0):
        return False
    steps, ratios = np.diff(values), np.diff(np.log(values))
    return bool(np.ptp(ratios) / abs(ratios.mean()) < np.ptp(steps) / abs(steps.mean()))


_UNITS = {"solve_s": "s", "seconds": "s", "penetration": "m"}
_SECONDS = "seconds"
_GAINS = {"K": "gain_K", "k": "gain_k"}
"""Names that parameters like to have."""
_OWN = {
    "scenario",
    "node",
    "interval",
    "state",
    "control",
    "contact",
    "contact_exact",
    "time",
    "x",
    "u",
    "lam",
    "gap",
    "x_replay",
    "u_replay",
    "x_referee",
    "u_referee",
    _SECONDS,
    *NUMBERS,
    *WORDS,
    *COUNTS,
}
"""Names that a study's dataset has itself."""


@dataclass(frozen=True)
class Grid:
    """A case over axes whose names are full (:meth:`~ocp.jobs.case.Case.full_name`)."""

    case: Case
    axes: tuple[Axis, ...]
    starts: int = 1
    seed: int = 0
    rank: Rank = "planned"

    @cached_property
    def source(self) -> ProblemSource:
        """What builds the problem, read once."""
        return self.case.source()

    @property
    def shape(self) -> tuple[int, ...]:
        """Values along each axis."""
        return tuple(len(axis.values) for axis in self.axes)

    @property
    def places(self) -> list[dict[str, float]]:
        """Values of every point by full name, the last axis fastest."""
        names = [axis.name for axis in self.axes]
        values = itertools.product(*(axis.values for axis in self.axes))
        return [dict(zip(names, one, strict=True)) for one in values]

    def shape_of(self, place: Mapping[str, float]) -> tuple[float, ...]:
        """Values of a point that decide over more than numbers: all but real parameters'."""
        fields = self.source.Params.model_fields

        def whole(name: str) -> bool:
            return fields[name.removeprefix("problem.")].annotation is int

        return tuple(
            value
            for name, value in place.items()
            if name.startswith(("setting.", "policy.")) or (name.startswith("problem.") and whole(name))
        )

    def job(self, place: Mapping[str, float], start: JobResult | None = None) -> SolveJob:
        """The job of a point, alone or from the plan of another one."""
        return SolveJob(self.case.at(place), self.starts, self.seed, self.rank, start=start)

    def neighbours(self, place: int) -> list[int]:
        """Places of the points one step away along an axis."""
        at, found = np.unravel_index(place, self.shape), list[int]()
        for axis, size in enumerate(self.shape):
            for moved in (at[axis] - 1, at[axis] + 1):
                if 0 <= moved < size:
                    near = (*at[:axis], moved, *at[axis + 1 :])
                    found.append(int(np.ravel_multi_index(near, self.shape)))
        return found

    def check(self) -> Session:
        """Build the first point, and see that no value of an axis is refused everywhere.

        Raises :class:`~ocp.errors.InputError` with the sentence of such a value.
        """
        source = self.source
        refused: dict[tuple[str, float], InputError] = {}
        passed: set[tuple[str, float]] = set()
        for place in self.places:
            try:
                source.params(self.case.at(place).params)
                passed |= set(place.items())
            except InputError as error:
                refused |= {item: error for item in place.items() if item not in refused}
        for item, error in refused.items():
            if item not in passed:
                raise error
        first = self.case.at(next(one for one in self.places if set(one.items()) <= passed))
        for axis in self.axes:
            for value in axis.values[:: max(1, len(axis.values) - 1)]:
                if not axis.name.startswith("problem."):
                    first.at({axis.name: value}).session(source)
        return first.session(source)

    def checkpoint(self, root: Path | None, name: str) -> Checkpoint:
        """What is kept of it in a store: that of changed files is another's."""
        asked = {
            "case": {**vars(self.case), "content": None},
            "axes": [vars(axis) for axis in self.axes],
            "starts": self.starts,
            "seed": self.seed,
            "rank": self.rank,
        }
        return Checkpoint(root, name, {"sweep": asked}, self.case.content or "")


def dimension(name: str) -> str:
    """What an axis of a full name is called in a dataset: ``M``, or ``contact.mu``."""
    short = name.removeprefix("problem.")
    return name if short in _OWN else short


def dataset(study: Grid, session: Session, points: Sequence[JobResult]) -> xr.Dataset:
    """Label all points: a dimension an axis, then those of the trajectories.

    Where points differ in size, as over N, what a point has not is NaN.
    """
    import xarray as xr

    dims = [dimension(axis.name) for axis in study.axes]
    data: dict[str, Any] = {}
    for name in (*NUMBERS, _SECONDS, *COUNTS, *WORDS):
        kind = {**dict.fromkeys(COUNTS, int), **dict.fromkeys(WORDS, object)}.get(name, float)
        values = np.array([point.row[name] for point in points], dtype=kind).reshape(study.shape)
        data[name] = (dims, values, {"units": _UNITS.get(name, "1")})
    for name in ("success", "survives"):
        data[name][2]["meaning"] = "1 yes, 0 no, -1 unknown"
    sizes = _sizes(points)
    for name in dict.fromkeys(name for point in points for name in point.arrays):
        shown = _stacked(name, study.shape, sizes, points)
        units = {"units": "s" if name == "time" else "see units of the problem's signals"}
        data[_GAINS.get(name, name)] = ((*dims, *shown.dims), shown.values, units)
    coordinates: dict[str, Any] = {
        dim: (dim, list(axis.values), {"units": _unit(session, axis.name)})
        for dim, axis in zip(dims, study.axes, strict=True)
    }
    labelled = {dim: labels for dim, labels in sizes.items() if isinstance(labels, list)}
    return xr.Dataset(data, coords={**coordinates, **labelled})


def _unit(session: Session, name: str) -> str:
    short = name.removeprefix("problem.")
    table = session.problem.parameters + session.step.p
    return table.get(short).unit if short in table else "1"


def _sizes(points: Iterable[JobResult]) -> dict[str, int | list[str]]:
    """Return the most entries that a point has in each dimension, or all labels in order."""
    counts: dict[str, int] = {}
    labels: dict[str, list[str]] = {}
    for array in (one for point in points for one in point.arrays.values()):
        for dim, size in zip(array.dims, array.values.shape, strict=True):
            known = labels.setdefault(dim, [])
            known += [label for label in array.labels.get(dim, ()) if label not in known]
            counts[dim] = max(counts.get(dim, 0), size)
    return {dim: labels[dim] or count for dim, count in counts.items()}


def _stacked(
    name: str,
    shape: tuple[int, ...],
    sizes: Mapping[str, int | list[str]],
    points: Sequence[JobResult],
) -> LabelledArray:
    dims = next(point.arrays[name].dims for point in points if name in point.arrays)
    ends = [size if isinstance(size := sizes[dim], int) else len(size) for dim in dims]
    values = np.full((math.prod(shape), *ends), np.nan)
    for place, point in enumerate(points):
        if name not in point.arrays:
            continue
        array = point.arrays[name]
        taken = [
            np.arange(size)
            if isinstance(known := sizes[dim], int)
            else [known.index(label) for label in array.labels[dim]]
            for dim, size in zip(dims, array.values.shape, strict=True)
        ]
        values[place][np.ix_(*taken)] = array.values
    return LabelledArray(dims, values.reshape(*shape, *ends), {})


def save_point(checkpoint: Checkpoint, place: int, point: JobResult) -> None:
    """Write a finished point, arrays first, so that a row means that they are whole."""
    about = {name: [array.dims, dict(array.labels)] for name, array in point.arrays.items()}
    if point.arrays:
        arrays = {name: array.values for name, array in point.arrays.items()}
        checkpoint.save_state(_file(place), **arrays)
    checkpoint.save_rows(place, [{"row": point.row, "arrays": json.dumps(about)}])


def saved_points(study: Grid, checkpoint: Checkpoint) -> dict[int, JobResult]:
    """Finished points by their places."""
    read = ((place, saved_point(checkpoint, place)) for place in range(math.prod(study.shape)))
    return {place: point for place, point in read if point is not None}


def saved_point(checkpoint: Checkpoint, place: int) -> JobResult | None:
    """A finished point, or solve from a neighbour, by its number; None where there is none."""
    rows = checkpoint.rows(place)
    if rows is None:
        return None
    about = json.loads(rows[0]["arrays"])
    values = checkpoint.state(_file(place)) if about else {}
    if values is None or set(values) != set(about):
        return None
    arrays = {name: LabelledArray(tuple(dims), values[name], labels) for name, (dims, labels) in about.items()}
    return JobResult(rows[0]["row"], arrays)


def _file(place: int) -> str:
    return f"arrays-{place:05d}"
