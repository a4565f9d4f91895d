"""``ocp estimate PROBLEM``: gradient estimators, compared with a reference gradient."""

from __future__ import annotations

from typing import Any

from ocp import store
from ocp.effort import check_time
from ocp.errors import choose, interruptible
from ocp.gradients.sweep import SweepRun, summary, sweep_dataset
from ocp.store.checkpoint import Checkpoint
from reports import estimates
from reports.cli import interrupt
from reports.cli.commands import BACKENDS, EstimateOptions
from reports.cli.estimate_request import EstimateRequest
from reports.cli.request import check_places


def check(options: EstimateOptions) -> tuple[EstimateRequest, SweepRun, Checkpoint]:
    """Build the objective at every point, and check the total time."""
    choose("backend", options.backend, dict.fromkeys(BACKENDS))
    request = EstimateRequest.read(options)
    check_places(options.out, options.pdf)
    key = {**request.decisive, "backend": options.backend}
    checkpoint = Checkpoint(options.out, request.spec.name, key, request.content)
    study = SweepRun(
        request.objective, request.sampling, request.sweep, checkpoint, request.rebuilt
    )
    what, seconds = f"{study.samples:.3g} samples of {request.spec.name}", study.seconds()
    check_time(what, seconds)
    options.output.announce(what, seconds)
    return request, study, checkpoint


def run(options: EstimateOptions, checked: tuple[EstimateRequest, SweepRun, Checkpoint]) -> int:
    """Estimate the gradient of a smoothed objective with several estimators, and judge each."""
    request, study, checkpoint = checked
    output, interrupted = options.output, False
    with checkpoint:
        for line in checkpoint.notes:
            output.say(line)
        try:
            with interruptible(), estimates.progress(options.quiet, interrupt.check) as report:
                study.run(report)
        except KeyboardInterrupt:
            if not study.rows:
                raise
            interrupted = True
        meta = _meta(request, study)
        data = sweep_dataset(study.widest, study.rows, request.sweep, request.unit())
        problem = getattr(request.objective, "problem", None)
        parts = {} if problem is None else store.problem_part(problem)
        stored = store.write(options.out, request.spec.name, data, meta, parts)
        if study.finished:
            checkpoint.discard()
    swept = None if request.sweep is None else request.sweep.name
    output.note(estimates.table(meta["estimates"], swept))
    if study.resumed:
        output.say(f"resumed; {study.resumed} points already complete")
    output.say(meta["verdict"])
    output.finish(stored, meta, options.pdf, request.spec)
    if interrupted:
        raise KeyboardInterrupt
    return 0


def _meta(request: EstimateRequest, study: SweepRun) -> dict[str, Any]:
    """Description of the stored run."""
    swept = request.sweep
    return {
        "kind": "estimate",
        "argv": request.options.argv,
        "tags": request.options.tags,
        "problem": request.spec.name,
        "seed": request.sampling.seed,
        "record": request.record,
        "source_digest": getattr(request.spec, "digest", None),
        "sweep": None if swept is None else {
            "name": swept.name, "values": list(swept.values), "unit": request.unit(),
            "log": swept.log,
        },
        "estimates": [row for point in study.rows for row in point],
        "status": "done" if study.finished else "stopped",
        "verdict": summary(study.rows),
    }  # fmt: skip
