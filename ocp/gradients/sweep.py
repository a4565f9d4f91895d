"""Estimate gradients along a parameter, point by point, and go on where a run was stopped."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from dynamics.batch import Gaussian
from ocp.gradients.estimation import Sampling, check_samples, run_sampling
from ocp.gradients.objective import SampledObjective
from ocp.gradients.sampling import Workers, reference_kind
from ocp.gradients.verdict import short_verdict
from ocp.store.checkpoint import Checkpoint
from ocp.store.json_values import to_json
from ocp.validation import Axis, spaced

if TYPE_CHECKING:
    import xarray as xr

Build = Callable[[dict[str, float]], SampledObjective]
"""Makes the objective at changed values of what shapes it, such as its horizon."""
_MANY, _PROBE = 3e9, 1 << 11
"""Noise numbers from which on a study is timed beforehand, and the samples that this takes."""
OF_THE_PLAN = ("sigma", "samples")


def read_sweep(text: str) -> Axis:
    """Read values of a parameter, one of :data:`OF_THE_PLAN`, or a component of the decision.

    ``problem.sigma`` is the problem's parameter of that name.

    Raises :class:`~ocp.errors.InputError` as :func:`~ocp.validation.spaced` does.
    """
    found = spaced("--sweep", text)
    if found.name != "samples":
        return found
    values = tuple(np.unique(np.rint(found.values)).tolist())
    for value in values:
        check_samples(value)
    return replace(found, values=values)


@dataclass(frozen=True)
class SweepProgress:
    """How far a study is: samples ``done`` of ``total``, and points finished of all."""

    done: int
    total: int
    points: int
    all_points: int
    resumed: int


class SweepRun:
    """A study under way. :meth:`run` does what is left; ``rows`` holds the finished points.

    Point i draws from the streams ``SeedSequence(seed, spawn_key=(i,))``, so that points are
    independent of each other and of how often the study was stopped. ``workers`` maps what of the
    objective is changed at a point to what samples it elsewhere.
    """

    def __init__(
        self,
        objective: SampledObjective,
        sampling: Sampling,
        sweep: Axis | None = None,
        checkpoint: Checkpoint | None = None,
        build: Build | None = None,
        workers: Callable[[dict[str, float]], Workers] | None = None,
    ) -> None:
        self._workers = workers
        self.sampling, self.sweep, self._checkpoint = sampling, sweep, checkpoint
        self._tasks = _points_of(objective, sampling, sweep, build)
        self.rows: list[list[dict[str, Any]]] = []
        self.resumed = 0

    @property
    def widest(self) -> SampledObjective:
        """The objective of the point whose decision has the most components."""
        return max((task[0] for task in self._tasks), key=lambda found: len(found.decision))

    @property
    def finished(self) -> bool:
        """Whether every point is done."""
        return len(self.rows) == len(self._tasks)

    @property
    def samples(self) -> int:
        """Samples at all points, those of references too."""
        return sum(self._sizes)

    @cached_property
    def _sizes(self) -> list[int]:
        """Samples at each point."""
        return [_size(*task) for task in self._tasks]

    def seconds(self) -> float:
        """Time that all samples take, from a probe where they are many; 0 where they are few."""
        most = self._tasks[int(np.argmax(self._sizes))]
        if self.samples * max(1, most[0].n_noise) < _MANY:
            return 0.0
        return self.samples * _probed(*most)

    def run(self, progress: Callable[[SweepProgress], None] | None = None) -> None:
        """Estimate at all points that are not finished, in their order."""
        sizes = self._sizes
        saved = self._checkpoint
        for i, (objective, sampling) in enumerate(self._tasks):
            before = [sum(sizes[:i])]

            def note(samples: int, i: int = i, before: list[int] = before) -> None:
                before[0] += samples
                if progress is not None:
                    told = SweepProgress(before[0], sum(sizes), i, len(sizes), self.resumed)
                    progress(told)

            rows = saved.rows(i) if saved is not None else None
            if rows is None:
                seed = np.random.SeedSequence(self.sampling.seed, spawn_key=(i,))
                keep = None if saved is None else (saved, f"{i:05d}")
                value = None if self.sweep is None else self.sweep.values[i]
                workers = self._workers and self._workers(self._changed(value))
                found = run_sampling(sampling, objective, seed, note, keep, workers)
                at = {"point": i, "value": value}
                rows = to_json([at | estimate.row() for estimate in found.values()])
                if saved is not None:
                    saved.save_rows(i, rows)
            else:
                self.resumed += 1
            self.rows.append(rows)

    def _changed(self, value: float | None) -> dict[str, float]:
        """What of the objective is swept, and its value."""
        if value is None or self.sweep is None or self.sweep.name in OF_THE_PLAN:
            return {}
        return {self.sweep.name.removeprefix("problem."): value}


def _points_of(
    objective: SampledObjective, sampling: Sampling, sweep: Axis | None, build: Build | None
) -> list[tuple[SampledObjective, Sampling]]:
    """Objective and sampling at each value; what cannot be is refused beforehand."""
    if sweep is None:
        return [(objective, sampling)]
    if sweep.name == "sigma":
        return [(objective, replace(sampling, sigma=value)) for value in sweep.values]
    if sweep.name == "samples":
        return [(objective, replace(sampling, samples=int(value))) for value in sweep.values]
    known = [*objective.parameters, *(signal.name for signal in objective.decision)]
    name = sweep.name.removeprefix("problem.")
    if name not in known and build is not None:
        return [(build({name: value}), sampling) for value in sweep.values]
    return [(objective.at({name: value}), sampling) for value in sweep.values]


def _probed(objective: SampledObjective, sampling: Sampling) -> float:
    """Seconds a sample, of the second of two batches: the first compiles."""
    noise = Gaussian(sampling.sigma, np.random.SeedSequence(sampling.seed))
    began = 0.0
    for _ in range(2):
        began = time.perf_counter()
        if objective.moments(noise, _PROBE, "zeroth") is None:
            objective.scored(noise, _PROBE)
    return (time.perf_counter() - began) / _PROBE


def _size(objective: SampledObjective, sampling: Sampling) -> int:
    samples = sampling.samples * len(sampling.sampled)
    sampled = reference_kind(objective, sampling.sigma, sampling.reference) == "zobg"
    return samples + sampled * sampling.most_reference_samples


def sweep_dataset(
    objective: SampledObjective,
    rows: Sequence[Sequence[dict[str, Any]]],
    sweep: Axis | None,
    unit: str = "1",
) -> xr.Dataset:
    """Rows of finished points as arrays over (point, estimator, component), with units.

    ``objective`` names the components; points that have fewer are filled up with NaN.
    """
    import xarray as xr

    d = len(objective.decision)
    names = [row["estimator"] for row in rows[0]]

    def stack(key: str, width: int) -> np.ndarray:
        values = np.full((len(rows), len(names), width), np.nan)
        for i, point in enumerate(rows):
            for j, row in enumerate(point):
                entry = np.ravel(np.array(row[key], dtype=float))
                values[i, j, : entry.size] = entry
        return values

    both = ("point", "estimator")
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
        data[key] = ((*both, "component"), stack(key, d))
        square = key == "variance" and shared not in ("1", "see component_unit")
        data[key].attrs["units"] = f"({shared})^2" if square else shared
    for key in ("n_samples", "evaluations", "error", "alpha", "epsilon", "gamma", "nonfinite"):
        data[key] = (both, stack(key, 1)[..., 0], {"units": "1"})
    for key in ("beta", "beta_upper", "Delta", "S", "bound", "sharp"):
        values = [[(row["empirical_bias"] or {}).get(key) for row in point] for point in rows]
        data[f"bias_{key}"] = (both, np.array(values, dtype=float), {"units": "1"})
    data["verdict"] = (both, [[row["verdict"] for row in point] for point in rows])
    if sweep is not None:
        values = [point[0]["value"] for point in rows]
        data = data.assign_coords(value=("point", values, {"units": unit, "name": sweep.name}))
    return data


def summary(rows: Sequence[Sequence[dict[str, Any]]]) -> str:
    """One sentence over all points: how each estimator fared."""
    told = []
    for j, row in enumerate(rows[0]):
        words = [short_verdict(point[j]) for point in rows]
        counts = {word: words.count(word) for word in dict.fromkeys(words)}
        only = len(counts) == 1
        parts = [word if only else f"{word} at {n} of {len(words)}" for word, n in counts.items()]
        told.append(f"{row['estimator']}: {', '.join(parts)}")
    return "; ".join(told) + "."
