"""Training runs of a study, computed in parallel and stored, and comparisons of their returns."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dynamics.contact import ContactLaw
from ocp.errors import choose
from ocp.jobs.scheduling import Function, Report, Workers, map_jobs
from ocp.learning.training import ALGORITHMS
from problems.studies.progress import report_progress
from problems.studies.study import Claim, FinishedParts, claim, settings_text
from problems.tasks import registry
from problems.tasks.registry import default_settings, make_algorithm
from problems.tasks.training import TrainingJob, run_training

Curves = dict[str, np.ndarray]
"""Mapping from names to arrays of one training run."""


def make_job(task: str, algorithm: str, law: ContactLaw, seed: int, **changed: Any) -> TrainingJob:
    """Return the job of one training run; ``changed`` are settings that differ from the task's defaults."""
    cls = choose("algorithm", algorithm, ALGORITHMS)
    values = {**default_settings(registry.spec(task), algorithm, cls), **changed}
    chosen, options = make_algorithm(cls, values)
    return TrainingJob(task=task, params={}, algorithm=chosen, law=law, seed=seed, options=options, threads=1)


def training_curves(jobs: Mapping[str, TrainingJob], finished: FinishedParts) -> dict[str, Curves]:
    """Run all training jobs; return a mapping from each job's key to its arrays (see :func:`side_by_side`).

    Except ``wall_s``, results do not depend on the number of processes.
    """
    return side_by_side(trained_curves, jobs, finished)


def trained_curves(job: TrainingJob, report: Report) -> Curves:
    """Run one training job and return its arrays, as a :data:`~ocp.jobs.scheduling.Function` does."""
    data = run_training(job, report)
    return {str(name): data[name].values for name in data.data_vars}


def side_by_side(function: Function, jobs: Mapping[str, Any], finished: FinishedParts) -> dict[str, Curves]:
    """Apply ``function`` to all jobs in parallel; return a mapping from each job's key to its arrays.

    Stored results are not computed again; for the others see :class:`FinishedParts`. Raises the error of a
    failed job.
    """
    results: dict[str, Curves] = {}
    report_progress("jobs", 0, len(jobs))
    for key, arrays in map_jobs(function, jobs, Workers(finished.jobs, finished.scheduler), finished):
        results[key] = arrays
        report_progress("jobs", len(results), len(jobs))
    return {key: results[key] for key in jobs}


def interpolate_finite(grid: np.ndarray, steps: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Interpolate the finite ``values`` at ``steps`` linearly at ``grid`` (n,); NaN outside their range."""
    measured = np.isfinite(values) & np.isfinite(steps)
    return np.interp(grid, steps[measured], values[measured], left=np.nan, right=np.nan)


RESAMPLES = 4000
"""Number of bootstrap resamples of the runs."""


@dataclass(frozen=True)
class Difference:
    """Difference of two means, and its 95 % bootstrap interval."""

    mean: float
    low: float
    high: float

    @property
    def better(self) -> bool:
        """Whether the whole interval is above zero."""
        return self.low > 0

    @property
    def margin(self) -> float:
        """Mean difference divided by its standard error, the width of the interval divided by 3.92."""
        width = self.high - self.low
        return self.mean / (width / 3.92) if width > 0 else float(np.copysign(np.inf, self.mean))

    def __str__(self) -> str:
        return f"{self.mean:+.3g} ({self.low:+.3g} to {self.high:+.3g})"


def mean_difference(runs: np.ndarray, other_runs: np.ndarray, paired: bool = True) -> Difference:
    """Return the difference of the means of ``runs`` and ``other_runs`` (n,), with its percentile bootstrap interval.

    ``paired`` runs share seeds and starts, and are resampled together. The resampling has seed 0,
    so that the same runs give the same interval.
    """
    rng = np.random.default_rng(0)
    chosen = rng.integers(len(runs), size=(RESAMPLES, len(runs)))
    other_chosen = chosen if paired else rng.integers(len(other_runs), size=(RESAMPLES, len(other_runs)))
    bootstrap = runs[chosen].mean(axis=1) - other_runs[other_chosen].mean(axis=1)
    low, high = np.quantile(bootstrap, [0.025, 0.975])
    return Difference(float(runs.mean() - other_runs.mean()), float(low), float(high))


def smallest_margin(gains: Iterable[Difference]) -> float:
    """Return the smallest margin of ``gains``, the margin of the claim that all gains are positive."""
    return min(gain.margin for gain in gains)


def claim_gains(
    sentence: str, source: str, expected: str, settings: Sequence[object], gains: list[Difference]
) -> Claim:
    """Return the claim that the intervals of all ``gains``, one for each of ``settings``, are above zero."""
    better = [gain.better for gain in gains]
    measured = f"{settings_text(settings, better)}: {', '.join(map(str, gains))}"
    return claim(sentence, source).expected(expected).measured(measured).holds(better, margin=smallest_margin(gains))


def mean_height(curve: np.ndarray) -> np.ndarray:
    """Return the mean height of each curve (..., iterations): the area under it divided by its length."""
    return (curve[..., 1:] + curve[..., :-1]).mean(axis=-1) / 2
