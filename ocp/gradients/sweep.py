"""Gradient estimates at several values of a parameter, which can be interrupted and resumed."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from dynamics.batch import Gaussian
from dynamics.settings import settings_of
from ocp.gradients.estimation import Sampling, run_sampling
from ocp.gradients.objective import SampledObjective
from ocp.gradients.sampling import ChunkSource, reference_kind
from ocp.gradients.verdict import short_verdict
from ocp.store.checkpoint import UNSAVED, SavedWork
from ocp.store.json_values import to_json
from ocp.validation import Axis, parse_axis_option

if TYPE_CHECKING:
    import xarray as xr

Build = Callable[[dict[str, float]], SampledObjective]
"""Function that builds an objective at other values of structural parameters, such as the horizon."""
_MIN_TIMED_NUMBERS = 3e9
"""Number of random numbers above which a few samples are timed to predict the run time of a sweep."""
_PROBE_SAMPLES = 1 << 11
"""Number of samples that are timed to predict a sweep's run time."""
SAMPLING_AXES = ("sigma", "samples")
"""Names of sweep axes that change the sampling instead of the objective."""


def read_sweep(text: str) -> Axis:
    """Parse a sweep axis: values of a parameter, of one of :data:`SAMPLING_AXES`, or of a decision's component.

    ``problem.sigma`` is the problem's parameter ``sigma``, and ``sigma`` the noise of the sampling.

    Raises the errors of :func:`~ocp.validation.parse_axis_option`.
    """
    axis = parse_axis_option("--sweep", text)
    if axis.name != "samples":
        return axis
    values = tuple(np.unique(np.rint(axis.values)).tolist())
    for value in values:
        settings_of(Sampling)["samples"].read(value)
    return replace(axis, values=values)


@dataclass(frozen=True)
class SweepProgress:
    """Progress of a sweep: numbers of samples (``done`` of ``total``) and of points (``points`` of ``all_points``)."""

    done: int
    total: int
    points: int
    all_points: int
    resumed: int


class SweepRun:
    """Sweep of gradient estimates: :meth:`run` computes the points, and ``rows`` contains the finished points.

    The random streams of point i are ``SeedSequence(seed, spawn_key=(i,))``, so that results are independent of
    other points and of interruptions. ``workers`` is a function whose argument maps the swept parameter to its
    value at a point; it returns workers that sample the objective at that point.
    """

    def __init__(
        self,
        objective: SampledObjective,
        sampling: Sampling,
        sweep: Axis | None = None,
        files: SavedWork = UNSAVED,
        build: Build | None = None,
        workers: Callable[[dict[str, float]], ChunkSource] | None = None,
    ) -> None:
        self._workers = workers
        self.sampling, self.sweep, self._files = sampling, sweep, files
        self._tasks = _point_tasks(objective, sampling, sweep, build)
        self.rows: list[list[dict[str, Any]]] = []
        self.resumed = 0

    @property
    def widest_objective(self) -> SampledObjective:
        """Objective of the point whose decision has the most components."""
        return max((task[0] for task in self._tasks), key=lambda objective: len(objective.decision))

    @property
    def finished(self) -> bool:
        """Whether all points are finished."""
        return len(self.rows) == len(self._tasks)

    @property
    def n_samples(self) -> int:
        """Total number of samples at all points, including those for references."""
        return sum(self._samples_per_point)

    @cached_property
    def _samples_per_point(self) -> list[int]:
        """Number of samples at each point, including those for its reference."""
        return [_samples_of_point(*task) for task in self._tasks]

    def predict_seconds(self) -> float:
        """Return the predicted run time [s] of all points, or 0 if there are few samples."""
        largest_task = self._tasks[int(np.argmax(self._samples_per_point))]
        if self.n_samples * max(1, largest_task[0].n_noise) < _MIN_TIMED_NUMBERS:
            return 0.0
        return self.n_samples * _seconds_per_sample(*largest_task)

    def run(self, progress: Callable[[SweepProgress], None] | None = None) -> None:
        """Estimate the gradient at all unfinished points, in order, and store the results."""
        sizes = self._samples_per_point
        for i, (objective, sampling) in enumerate(self._tasks):
            samples_done = [sum(sizes[:i])]

            def report_samples(samples: int, i: int = i, samples_done: list[int] = samples_done) -> None:
                samples_done[0] += samples
                if progress is not None:
                    state = SweepProgress(samples_done[0], sum(sizes), i, len(sizes), self.resumed)
                    progress(state)

            rows = self._files.rows(i)
            if rows is None:
                seed = np.random.SeedSequence(self.sampling.seed, spawn_key=(i,))
                value = None if self.sweep is None else self.sweep.values[i]
                workers = self._workers and self._workers(self._swept_value(value))
                estimates = run_sampling(sampling, objective, seed, report_samples, (self._files, f"{i:05d}"), workers)
                labels = {"point": i, "value": value}
                rows = to_json([labels | estimate.row() for estimate in estimates.values()])
                self._files.save_rows(i, rows)
            else:
                self.resumed += 1
            self.rows.append(rows)

    def _swept_value(self, value: float | None) -> dict[str, float]:
        """Return a mapping from the objective's swept parameter to ``value``; empty if the sampling is swept."""
        if value is None or self.sweep is None or self.sweep.name in SAMPLING_AXES:
            return {}
        return {self.sweep.name.removeprefix("problem."): value}


def _point_tasks(
    objective: SampledObjective, sampling: Sampling, sweep: Axis | None, build: Build | None
) -> list[tuple[SampledObjective, Sampling]]:
    """Return the objective and the sampling at each point; raise InputError for invalid values."""
    if sweep is None:
        return [(objective, sampling)]
    if sweep.name == "sigma":
        return [(objective, replace(sampling, sigma=value)) for value in sweep.values]
    if sweep.name == "samples":
        return [(objective, replace(sampling, samples=int(value))) for value in sweep.values]
    names = [*objective.parameters, *(signal.name for signal in objective.decision)]
    name = sweep.name.removeprefix("problem.")
    if name not in names and build is not None:
        return [(build({name: value}), sampling) for value in sweep.values]
    return [(objective.at({name: value}), sampling) for value in sweep.values]


def _seconds_per_sample(objective: SampledObjective, sampling: Sampling) -> float:
    """Return the time per sample [s] of a second batch, since the first batch includes compilation."""
    noise = Gaussian(sampling.sigma, np.random.SeedSequence(sampling.seed))
    start = 0.0
    for _ in range(2):
        start = time.perf_counter()
        if objective.moments(noise, _PROBE_SAMPLES, "zeroth") is None:
            objective.sample_scores(noise, _PROBE_SAMPLES)
    return (time.perf_counter() - start) / _PROBE_SAMPLES


def _samples_of_point(objective: SampledObjective, sampling: Sampling) -> int:
    samples = sampling.samples * len(sampling.sampled)
    sampled = reference_kind(objective, sampling.sigma, sampling.reference) == "zobg"
    return samples + sampled * sampling.n_reference_samples


def sweep_dataset(
    objective: SampledObjective,
    rows: Sequence[Sequence[dict[str, Any]]],
    sweep: Axis | None,
    unit: str = "1",
) -> xr.Dataset:
    """Return finished points as a dataset of arrays over (point, estimator, component), with units.

    Names of components are taken from ``objective``; points with fewer components are padded with NaN.
    """
    import xarray as xr

    d = len(objective.decision)
    names = [row["estimator"] for row in rows[0]]

    def stack_rows(key: str, width: int) -> np.ndarray:
        values = np.full((len(rows), len(names), width), np.nan)
        for i, point in enumerate(rows):
            for j, row in enumerate(point):
                entry = np.ravel(np.array(row[key], dtype=float))
                values[i, j, : entry.size] = entry
        return values

    per_estimator = ("point", "estimator")
    units = [f"1/({s.unit})" if s.unit != "1" else "1" for s in objective.decision]
    data = xr.Dataset(
        coords={
            "estimator": names,
            "component": [signal.name for signal in objective.decision],
            "component_unit": ("component", units),
        }
    )
    shared = units[0] if len(set(units)) == 1 else "see component_unit"
    for key in ("mean", "variance", "standard_error", "reference", "reference_error"):
        data[key] = ((*per_estimator, "component"), stack_rows(key, d))
        square = key == "variance" and shared not in ("1", "see component_unit")
        data[key].attrs["units"] = f"({shared})^2" if square else shared
    for key in ("n_samples", "evaluations", "error", "alpha", "epsilon", "gamma", "nonfinite"):
        data[key] = (per_estimator, stack_rows(key, 1)[..., 0], {"units": "1"})
    for key in ("beta", "beta_upper", "Delta", "S", "bound", "sharp"):
        values = [[(row["empirical_bias"] or {}).get(key) for row in point] for point in rows]
        data[f"bias_{key}"] = (per_estimator, np.array(values, dtype=float), {"units": "1"})
    data["verdict"] = (per_estimator, [[row["verdict"] for row in point] for point in rows])
    if sweep is not None:
        values = [point[0]["value"] for point in rows]
        data = data.assign_coords(value=("point", values, {"units": unit, "name": sweep.name}))
    return data


def summarise_verdicts(rows: Sequence[Sequence[dict[str, Any]]]) -> str:
    """Return a sentence that lists each estimator's verdicts, with the number of points for each."""
    sentences = []
    for j, row in enumerate(rows[0]):
        verdicts = [short_verdict(point[j]) for point in rows]
        counts = {verdict: verdicts.count(verdict) for verdict in dict.fromkeys(verdicts)}
        unanimous = len(counts) == 1
        counted = [verdict if unanimous else f"{verdict} at {n} of {len(verdicts)}" for verdict, n in counts.items()]
        sentences.append(f"{row['estimator']}: {', '.join(counted)}")
    return "; ".join(sentences) + "."
