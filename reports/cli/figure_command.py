"""``ocp figure ID...``: reproduce figures of the papers, with their claims checked.

A stored run in place of an ID is only drawn again, as a bare figure.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from string import ascii_lowercase
from typing import Any

import xarray as xr
from rich.progress import Progress, TaskID

from ocp import store
from ocp.errors import InputError, choose
from ocp.jobs.scheduling import Workers, map_jobs
from ocp.problem.resources import STUDY, check_memory
from ocp.store import atomic
from ocp.store.checkpoint import Checkpoint
from ocp.store.stored_run import StoredRun
from problems import studies
from problems.studies import FigureStudy
from problems.studies.progress import listen_to_progress
from problems.studies.study import claims_sentence
from reports.cli import interrupt
from reports.cli.options.output import FigureOptions
from reports.cli.request import check_outputs, parse_assignments
from reports.documents.pdf import write_pdf
from reports.figures.paper import FORMATS, bare_figure
from reports.tables.listings import claim_table

FigureRequest = list["tuple[FigureStudy, dict[str, Any]] | StoredRun"]


def check(options: FigureOptions) -> FigureRequest:
    """Return the studies, each with all its parameters, and the stored runs, in the order of the arguments."""
    named = options.figures or []
    if options.every == bool(named):
        raise InputError(f"give figures or --all; available: {', '.join(studies.ids())}")
    values: dict[str, Any] = parse_assignments("-p", options.params)
    if values and len(named) != 1:
        raise InputError("-p sets a parameter of one study; name a single figure")
    if "seed" in values and "seed" in options.explicit:
        raise InputError("--seed and -p seed set the same value; drop one of them")
    if options.ending is not None:
        choose("format", options.ending, FORMATS)
    if options.panel is not None and options.panel not in set(ascii_lowercase):
        raise InputError(f"--panel must be a letter from a to z, got {options.panel!r}")
    names = list(dict.fromkeys(named)) or studies.ids()
    study_values = {"seed": options.seed, **values}
    runs = options.named_runs
    requests = [options.stored(name) if name in runs else _study(name, study_values, options) for name in names]
    check_outputs(options.out, None)
    return requests


def _study(name: str, values: dict[str, Any], options: FigureOptions) -> tuple[FigureStudy, dict[str, Any]]:
    study = studies.get(name)
    params = study.params({**(study.quick if options.quick else {}), **values}).model_dump()
    counts = {n: f.default for n, f in study.Params.model_fields.items() if f.annotation is int}
    growth = math.prod(max(1.0, params[n] / default_count) for n, default_count in counts.items() if default_count)
    check_memory(f"{study.id} with {', '.join(options.params or ())}", STUDY * growth)
    return study, params


def run(options: FigureOptions, request: FigureRequest) -> int:
    """Run studies, store them, draw them to ID.pdf, write data to ID.nc, and check claims; draw stored runs again."""
    document_at: dict[int, dict[str, Any]] = {}
    for number, requested in enumerate(request):
        if isinstance(requested, StoredRun):
            file = _write_bare_figure(requested, options)
            options.output.say(f"files: {file}")
            document_at[number] = {"id": requested.meta["problem"], "files": [str(file)], "run": str(requested.path)}
    named = {number: requested for number, requested in enumerate(request) if isinstance(requested, tuple)}
    for number, data in _compute_studies(named, options):
        document_at[number] = _finish_study(*named[number], data, options)
    documents = [document_at[number] for number in sorted(document_at)]
    options.output.document(documents[0] if len(options.figures or ()) == 1 else {"figures": documents})
    return 0


@dataclass(frozen=True)
class FigureJob:
    """Job that computes a study with its parameters; finished parts are stored in the store ``out``."""

    study: str
    params: dict[str, Any]
    out: Path


def study_data(job: FigureJob, report: Callable[[Any], None]) -> xr.Dataset:
    """Return the data of a study, computed in one process (a :data:`~ocp.jobs.scheduling.Function`)."""
    study = studies.get(job.study)
    with Checkpoint(job.out if study.resumes else None, study.id, job.params) as checkpoint:
        return study.data(job.params, checkpoint, jobs=1)


def _compute_studies(
    named: dict[int, tuple[FigureStudy, dict[str, Any]]], options: FigureOptions
) -> Iterator[tuple[int, xr.Dataset]]:
    """Yield index and data of every study; ``--jobs`` runs several studies, or the parts of a study, in parallel."""
    if not options.parallel or len(named) == 1:
        for number, (study, params) in named.items():
            yield number, _compute_study(study, params, options)
        return
    jobs = {number: FigureJob(study.id, params, options.out.resolve()) for number, (study, params) in named.items()}

    def explain(number: int, error: Exception) -> None:
        with _explain_errors(*named[number]):
            raise error

    with closing(map_jobs(study_data, jobs, Workers(options.jobs, options.scheduler), recover=explain)) as outcomes:
        yield from outcomes


def _compute_study(study: FigureStudy, params: dict[str, Any], options: FigureOptions) -> xr.Dataset:
    if not options.output.quiet:
        print(f"{study.id}: {study.title}", file=sys.stderr, flush=True)
    jobs = options.jobs if "jobs" in options.explicit else None
    with Checkpoint(options.out if study.resumes else None, study.id, params) as checkpoint:
        for line in checkpoint.notes:
            options.output.say(line)
        with _explain_errors(study, params), _progress(options):
            return study.data(params, checkpoint, jobs, options.scheduler)


@contextmanager
def _progress(options: FigureOptions) -> Iterator[None]:
    """Show a progress bar with the remaining time of a study's current loop; only on a terminal."""
    hidden = options.output.quiet or not options.output.console.is_terminal
    with Progress(
        *Progress.get_default_columns(), console=options.output.console, transient=True, disable=hidden
    ) as bar:
        tasks: dict[str, TaskID] = {}

        def on_progress(loop: str, done: int, total: int) -> None:
            interrupt.raise_if_interrupted()
            if loop not in tasks:
                tasks[loop] = bar.add_task(loop)
            bar.update(tasks[loop], completed=done, total=total)

        with listen_to_progress(on_progress):
            yield


def _write_bare_figure(run: StoredRun, options: FigureOptions) -> Path:
    ending = options.ending or "pdf"
    file = options.out / f"{run.meta['problem']}-{options.panel or 'figure'}.{ending}"
    atomic.write_file(file, bare_figure(run, ending, options.panel), "the figure")
    return file


@contextmanager
def _explain_errors(study: FigureStudy, params: dict[str, Any]) -> Iterator[None]:
    """Convert an error of a study at parameters other than its defaults to an InputError with these parameters.

    At the default parameters an error is a defect of the program. At other parameters a study may have no
    result, since the range of each parameter is checked separately; for example, a ball may land outside the
    observed interval.
    """
    defaults = study.params({}).model_dump()
    chosen = [f"{name}={value}" for name, value in params.items() if name != "seed" and value != defaults[name]]
    try:
        yield
    except (ArithmeticError, IndexError, ValueError) as error:
        if not chosen or isinstance(error, InputError):
            raise
        reason = " ".join(str(error).split())
        raise InputError(
            f"{study.id} has no result at {', '.join(chosen)} ({reason}); choose values closer to its defaults"
        ) from error


def _finish_study(
    study: FigureStudy, params: dict[str, Any], data: xr.Dataset, options: FigureOptions
) -> dict[str, Any]:
    """Store the data, check the claims, draw the figure, and return its JSON document."""
    out, output = options.out, options.output
    with _explain_errors(study, params):
        claims = study.claims(data)
    meta = {
        "kind": "figure",
        "argv": options.argv,
        "seed": params["seed"],
        "record": {"params": params},
        "claims": [asdict(claim) for claim in claims],
        "verdict": claims_sentence(claims),
        "status": "done",
    }
    stored = store.write_run(out, study.id, data, meta)
    with Checkpoint(out if study.resumes else None, study.id, params) as checkpoint:
        checkpoint.discard()
    pdf, copy = out / f"{study.id}.pdf", out / f"{study.id}.nc"
    with _explain_errors(study, params):
        write_pdf([stored], pdf)
    # netCDF 3, since HDF5 stores the time of writing, and equal data would give different files.
    atomic.write_file(copy, bytes(data.to_netcdf(engine="scipy", format="NETCDF3_64BIT")))
    output.note(claim_table(claims))
    output.say(f"{study.id}: {meta['verdict']}")
    files = [str(pdf), str(copy)]
    if options.ending or options.panel:
        files.append(str(_write_bare_figure(stored, options)))
    output.say(f"files: {', '.join(files)}")
    return {
        "id": study.id,
        "title": study.title,
        "files": files,
        "run": str(stored.path),
        "seed": params["seed"],
        "claims": meta["claims"],
    }
