"""Measurements of simulators as jobs, and ``ocp.gradient_report``: whether their gradients are right."""

from __future__ import annotations

import pickle
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from os import PathLike, fspath
from pathlib import Path
from typing import Any

import numpy as np

from ocp import plugins
from ocp.errors import InputError
from ocp.gradients.worlds.report import GradientReport, Measurements, Question, ReportSettings
from ocp.gradients.worlds.world import Simulation, World
from ocp.jobs.scheduling import THIS_PROCESS, Workers, map_jobs
from ocp.solution import Solution
from ocp.store.checkpoint import UNSAVED, SavedWork
from ocp.store.lookup import load_solution
from ocp.store.provenance import FilesChanged
from ocp.validation import expand_path


@dataclass(frozen=True)
class WorldJob:
    """Job that makes measurement ``index`` of a case, which any process builds again from these texts and numbers.

    ``source`` is the name of a scene or a file, or the directory of a run whose problem is defined in
    ``problem_file``, if it is one of the user's. ``content`` is the digest of the files of the case.
    """

    source: str | Path
    worlds: tuple[str, ...] = ()
    values: Mapping[str, float] | None = None
    parameter: int = 0
    output: int = 0
    problem_file: str | None = None
    settings: ReportSettings = field(default_factory=ReportSettings)
    content: str = ""
    index: int = 0

    def __post_init__(self) -> None:
        # Workers may run in another directory.
        for name in ("source", "problem_file"):
            object.__setattr__(self, name, _absolute(getattr(self, name)))
        object.__setattr__(self, "worlds", tuple(map(_absolute, self.worlds)))

    def build(self) -> Measurements:
        """Build the measurements of the case.

        Raises :class:`~ocp.store.provenance.FilesChanged` if a file has changed since the request.
        """
        is_run = isinstance(self.source, Path)
        source = load_solution(self.source, source=self.problem_file) if is_run else self.source
        arguments = (source, self.worlds, self.values, self.parameter, self.output, self.settings.seed)
        case = plugins.problems.gradient_case(*arguments)
        if case.content != self.content:
            raise FilesChanged(f"a file of {case.name} has changed since this was begun; give the same command again")
        return Measurements(case.worlds, case.questions, self.settings)


def _absolute(name: Any) -> Any:
    """Return a path, or the name of a file, as an absolute one; other names as they are."""
    is_file = isinstance(name, str) and name.endswith(".py")
    return str(expand_path(name).resolve()) if is_file else name.resolve() if isinstance(name, Path) else name


# The state is local to a thread, since Dask may run two jobs in one process, each in its own thread.
_last_case = threading.local()


def measure_world(job: WorldJob, report: Callable[[Any], None]) -> dict[str, Any]:
    """Return the row of a job; if this thread's last job was of the same case, the case is not built again."""
    key = pickle.dumps(replace(job, index=0))
    if getattr(_last_case, "key", None) != key:
        _last_case.measurements, _last_case.key = job.build(), key
    return _last_case.measurements.row(job.index, report)


@dataclass(frozen=True)
class _SavedRows:
    """Storage of rows as a :class:`~ocp.jobs.scheduling.SavedResults`."""

    files: SavedWork

    def load(self, index: int) -> dict[str, Any] | None:
        rows = self.files.rows(index)
        return rows[0] if rows else None

    def save(self, index: int, row: dict[str, Any]) -> dict[str, Any]:
        self.files.save_rows(index, [row])
        return row


def count_saved(files: SavedWork, count: int) -> int:
    """Return how many of ``count`` measurements are saved."""
    return sum(files.rows(index) is not None for index in range(count))


def measure_worlds(
    worlds: Sequence[World],
    questions: Question | Sequence[Question],
    settings: ReportSettings | None = None,
    files: SavedWork = UNSAVED,
    progress: Callable[[int, str], None] = lambda *_: None,
    workers: Workers = THIS_PROCESS,
    job: WorldJob | None = None,
) -> GradientReport:
    """Measure the gradient of each simulator; judge whether it is its output's derivative, and the exact derivative.

    With several ``questions`` of equal size, each simulator is measured for each of them. Finished measurements are
    saved to ``files``, from which the same call resumes. A simulator that raises gets a row with the status
    ``failed``, and the others are measured. ``progress`` is called with the index of a measurement and a text on what
    it is doing. Other processes build the same case from ``job``; results do not depend on the ``workers``.

    Raises :class:`~ocp.errors.InputError` if all simulators fail, or if the exact output cannot be computed.
    """
    measurements, failures = Measurements(worlds, questions, settings), list[Exception]()
    indices = range(len(measurements.names))

    def recover(index: int, error: Exception) -> dict[str, Any]:
        if isinstance(error, FilesChanged):
            raise error
        failures.append(error)
        return measurements.failed_row(index, error)

    function, jobs = (lambda index, report: measurements.row(index, report)), {index: index for index in indices}
    if job is not None and not workers.serial:
        function, jobs = measure_world, {index: replace(job, index=index) for index in indices}
    with closing(map_jobs(function, jobs, workers, _SavedRows(files), progress, recover)) as rows_of_jobs:
        rows = dict(rows_of_jobs)
    if len(failures) == len(rows):
        raise failures[0]
    return GradientReport(measurements.questions[0], [rows[index] for index in indices])


def gradient_report(
    source: str | PathLike[str] | Solution | Simulation,
    worlds: Sequence[str] = (),
    *,
    theta: Sequence[float] | float | None = None,
    gradient: Simulation | None = None,
    truth: Simulation | None = None,
    size: float | None = None,
    settings: Mapping[str, float] | None = None,
    jobs: int = 1,
    **options: Any,
) -> GradientReport:
    """Judge whether the gradients of simulators are right, as ``ocp gradients`` does::

        gradient_report("oblique-drop", ["exact", "mujoco"]).sentences
        gradient_report(rollout, theta=[0.5], truth=closed_form).rows[0]["verdict"]

    ``source`` is the name of a scene, the path of a file that defines ``rollout(theta)``, a solution, whose cost is
    judged along directions of its inputs, or that function: from parameters (n, d) to outputs (n, m). A function needs
    the nominal parameters ``theta`` (d,); optional are its ``gradient``, from (n, d) to (n, m, d), the exact outputs
    ``truth``, from (n, d) to (n, m), and the ``size`` of the first parameter, by default its absolute value. The report
    is on the derivative of the first output by the first parameter. ``worlds`` are names of simulators or files, and
    ``settings`` values of their settings. The simulators of scenes and files are measured by ``jobs`` processes, or on
    a Dask cluster. ``options`` are those of :class:`ReportSettings`, and ``scheduler``, the address of the cluster.

    Raises :class:`~ocp.errors.InputError` for unknown names, and for simulators of wrong shape or without a seed.
    """
    workers = Workers(jobs, options.pop("scheduler", None))
    report_settings = ReportSettings(**options)
    if not workers.serial and not isinstance(source, str | PathLike):
        raise InputError("functions and solutions are measured in one process; drop jobs and scheduler, or name a file")
    if not callable(source):
        if theta is not None or gradient is not None or truth is not None or size is not None:
            raise InputError("theta, gradient, truth and size are for a function; a file defines them itself")
        named = source if isinstance(source, Solution) else fspath(source)
        case = plugins.problems.gradient_case(named, worlds, settings, seed=report_settings.seed)
        job = WorldJob(str(named), tuple(worlds), settings, settings=report_settings, content=case.content)
        return measure_worlds(case.worlds, case.questions, report_settings, workers=workers, job=job)
    if theta is None or worlds:
        raise InputError("a function needs theta, its nominal parameters, and is compared with no other simulators")
    nominal = np.atleast_1d(np.asarray(theta, dtype=float))
    scale = abs(float(nominal[0])) if size is None else size
    if not scale > 0:
        raise InputError(f"the size of the parameter must be > 0, got {scale:g}; set size")
    world = World(getattr(source, "__name__", "rollout"), source, gradient, settings or {})
    exact_world = None if truth is None else World("truth", truth)
    return measure_worlds([world], Question(nominal, scale, exact_world), report_settings)
