"""``ocp estimate PROBLEM``: gradient estimators, compared with a reference gradient."""

from __future__ import annotations

from typing import Any

from ocp import store
from ocp.errors import choose, interruptible
from ocp.gradients.sweep import SweepRun, summarise_verdicts, sweep_dataset
from ocp.problem.resources import check_time
from ocp.store.checkpoint import Checkpoint
from reports.cli import interrupt
from reports.cli.commands import BACKENDS, EstimateOptions
from reports.cli.estimate_request import EstimateRequest
from reports.cli.request import check_outputs
from reports.tables.listings import estimate_progress, estimate_table


def check(options: EstimateOptions) -> tuple[EstimateRequest, SweepRun, Checkpoint]:
    """Return the request, its sweep with all objectives built, and its checkpoint; check the predicted time."""
    choose("backend", options.backend, dict.fromkeys(BACKENDS))
    request = EstimateRequest.read(options)
    check_outputs(options.out, options.pdf)
    key = {**request.decisive, "backend": options.backend}
    checkpoint = Checkpoint(options.out, request.spec.name, key, request.content)
    study = SweepRun(request.objective, request.sampling, request.sweep, checkpoint, request.rebuilt, request.workers)
    task, seconds = f"{study.n_samples:.3g} samples of {request.spec.name}", study.predict_seconds()
    check_time(task, seconds)
    options.output.announce(task, seconds)
    return request, study, checkpoint


def run(options: EstimateOptions, checked: tuple[EstimateRequest, SweepRun, Checkpoint]) -> int:
    """Estimate the gradient of a smoothed objective with several estimators, and judge each."""
    request, study, checkpoint = checked
    output, interrupted = options.output, False
    with checkpoint:
        for line in checkpoint.notes:
            output.say(line)
        try:
            with interruptible(), estimate_progress(options.quiet, interrupt.raise_if_interrupted) as report:
                study.run(report)
        except KeyboardInterrupt:
            if not study.rows:
                raise
            interrupted = True
        meta = _meta(request, study)
        data = sweep_dataset(study.widest_objective, study.rows, request.sweep, request.unit())
        problem = getattr(request.objective, "problem", None)
        problem_part = {} if problem is None else store.problem_parts(problem)
        stored = store.write_run(options.out, request.spec.name, data, meta, problem_part)
        if study.finished:
            checkpoint.discard()
    swept = None if request.sweep is None else request.sweep.name
    output.note(estimate_table(meta["estimates"], swept))
    if study.resumed:
        output.say(f"resumed; {study.resumed} points already complete")
    output.say(meta["verdict"])
    output.finish(stored, meta, options.pdf, request.spec)
    if interrupted:
        raise KeyboardInterrupt
    return 0


def _meta(request: EstimateRequest, study: SweepRun) -> dict[str, Any]:
    """Return the metadata of the run to be stored."""
    swept = request.sweep
    return {
        "kind": "estimate",
        "argv": request.options.argv,
        "tags": request.options.tags,
        "problem": request.spec.name,
        "seed": request.sampling.seed,
        "record": request.record,
        "source_digest": getattr(request.spec, "digest", None),
        "sweep": None
        if swept is None
        else {"name": swept.name, "values": list(swept.values), "unit": request.unit(), "log": swept.log},
        "estimates": [row for point in study.rows for row in point],
        "status": "done" if study.finished else "stopped",
        "verdict": summarise_verdicts(study.rows),
    }
