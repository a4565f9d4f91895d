"""``ocp estimate PROBLEM``: gradient estimators, compared with a reference gradient."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from reports.cli.options import Command, ProblemOptions, option

if TYPE_CHECKING:
    from ocp.gradients.sweep import SweepRun
    from ocp.store.checkpoint import Checkpoint
    from reports.cli.estimate_request import EstimateRequest

BACKENDS = ("auto", "c", "numpy", "casadi")
"""Engines of batched evaluation; auto takes the first that can be built."""


@dataclass(frozen=True, kw_only=True)
class EstimateOptions(ProblemOptions):
    """Estimators, samples, noise, sweep and engine."""

    estimators: str = option(
        "zobg,fobg,alpha", "--estimators", help="Names separated by commas; list with ocp list."
    )
    samples: str = option("1e5", "--samples", "-n", help="Samples per estimator.")
    sweep: str | None = option(None, "--sweep", metavar="NAME=A:B:n[:log]", help="Sweep over NAME.")
    sigma: float | None = option(None, "--sigma", help="Standard deviation of the noise.")
    reference: str = option(
        "auto", "--reference", help="auto, closed-form, quadrature, zobg or none."
    )
    reference_samples: str | None = option(
        None, "--reference-samples", help="Samples of a sampled reference."
    )
    at: str | None = option(None, "--at", help="Stored run whose inputs are the decision.")
    backend: str = option(
        "auto", "--backend", help=f"{', '.join(BACKENDS[:-1])} or {BACKENDS[-1]}."
    )
    threads: int | None = option(None, "--threads", min=1, max=1024, help="CPUs to use.")


def check(options: EstimateOptions) -> tuple[EstimateRequest, SweepRun, Checkpoint]:
    """Build the objective at every point, and check the total time."""
    from ocp.effort import check_time
    from ocp.errors import choose
    from ocp.gradients.sweep import SweepRun
    from ocp.store.checkpoint import Checkpoint
    from reports.cli.estimate_request import EstimateRequest
    from reports.cli.request import check_places

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
    """Estimate the gradient of a smoothed objective with several estimators, and judge each.

    The cost of an objective, or of a problem's rollout, is averaged over Gaussian noise on the
    decision or on the inputs. Finished points are kept: after Ctrl-C the same command resumes.
    """
    from ocp import store
    from ocp.errors import interruptible
    from ocp.gradients.sweep import sweep_dataset
    from reports import estimates
    from reports.cli import interrupt

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
    from ocp.gradients.sweep import summary

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


COMMAND = Command(
    EstimateOptions,
    check,
    run,
    examples=(
        "estimate heaviside --samples 1e5 --sweep sigma=0.01:1:9:log",
        "estimate push-1d --contact exact --estimators zobg,alpha -s alpha.gamma=1",
    ),
)
