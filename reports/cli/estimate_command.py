"""``ocp estimate PROBLEM``: gradient estimators held against what is known."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from reports.cli.options import Command, ProblemOptions, option

if TYPE_CHECKING:
    from ocp.gradients.sweep import SweepRun
    from ocp.store.checkpoint import Checkpoint
    from reports.cli.estimate_request import EstimateRequest

BACKENDS = ("auto", "c", "numpy", "casadi")
"""What evaluates many samples at once; auto takes the first that can be built."""


@dataclass(frozen=True, kw_only=True)
class EstimateOptions(ProblemOptions):
    """Estimators, samples, noise, the sweep, and what computes."""

    estimators: str = option(
        "zobg,fobg,alpha", "--estimators", help="Names with commas; ocp list shows them."
    )
    samples: str = option("1e5", "--samples", "-n", help="Of each estimator.")
    sweep: str | None = option(None, "--sweep", metavar="NAME=A:B:n[:log]", help="Go along NAME.")
    sigma: float | None = option(None, "--sigma", help="Size of the noise.")
    reference: str = option(
        "auto", "--reference", help="auto, closed-form, quadrature, zobg or none."
    )
    reference_samples: str | None = option(
        None, "--reference-samples", help="Of a sampled reference."
    )
    at: str | None = option(None, "--at", help="A stored run whose inputs are the decision.")
    backend: str = option(
        "auto", "--backend", help=f"{', '.join(BACKENDS[:-1])} or {BACKENDS[-1]}."
    )
    threads: int | None = option(None, "--threads", min=1, max=1024, help="CPUs to use.")


def check(options: EstimateOptions) -> tuple[EstimateRequest, SweepRun, Checkpoint]:
    """Build the objective at every point, and see that all of them would end within a year."""
    from ocp.effort import check_time
    from ocp.errors import choose
    from ocp.gradients.sweep import SweepRun
    from ocp.store.checkpoint import Checkpoint
    from reports.cli.estimate_request import EstimateRequest
    from reports.cli.request import check_places

    choose("backend", options.backend, dict.fromkeys(BACKENDS))
    asked = EstimateRequest.read(options)
    check_places(options.out, options.pdf)
    request = {**asked.decisive, "backend": options.backend}
    checkpoint = Checkpoint(options.out, asked.spec.name, request, asked.content)
    study = SweepRun(asked.objective, asked.sampling, asked.sweep, checkpoint, asked.rebuilt)
    what, seconds = f"{study.samples:.3g} samples of {asked.spec.name}", study.seconds()
    check_time(what, seconds)
    options.output.foretell(what, seconds)
    return asked, study, checkpoint


def run(options: EstimateOptions, checked: tuple[EstimateRequest, SweepRun, Checkpoint]) -> int:
    """Estimate the gradient of a smoothed objective, several ways, and judge each.

    The cost of an objective, or of a problem's rollout, is averaged over Gaussian noise on the
    decision or on the inputs. What is done is kept: the same command goes on after Ctrl-C.
    """
    from ocp import store
    from ocp.errors import interruptible
    from ocp.gradients.sweep import sweep_dataset
    from reports import estimates
    from reports.cli import interrupt

    asked, study, checkpoint = checked
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
        meta = _meta(asked, study)
        data = sweep_dataset(study.widest, study.rows, asked.sweep, asked.unit())
        problem = getattr(asked.objective, "problem", None)
        parts = {} if problem is None else store.shown(problem)
        path = store.write(options.out, asked.spec.name, data, meta, parts)
        if study.finished:
            checkpoint.discard()
    swept = None if asked.sweep is None else asked.sweep.name
    output.note(estimates.table(meta["estimates"], swept))
    if study.resumed:
        output.say(f"went on from {study.resumed} points that were done before")
    output.say(meta["verdict"])
    output.finish(path, meta, options.pdf, asked.spec)
    if interrupted:
        raise KeyboardInterrupt
    return 0


def _meta(asked: EstimateRequest, study: SweepRun) -> dict[str, Any]:
    """What is stored of the finished points beside their arrays."""
    from ocp.gradients.sweep import overall

    swept = asked.sweep
    return {
        "kind": "estimate",
        "argv": asked.options.argv,
        "tags": asked.options.tags,
        "problem": asked.spec.name,
        "seed": asked.sampling.seed,
        "record": asked.record,
        "source_digest": getattr(asked.spec, "digest", None),
        "sweep": None if swept is None else {
            "name": swept.name, "values": list(swept.values), "unit": asked.unit(),
            "log": swept.log,
        },
        "estimates": [row for point in study.rows for row in point],
        "status": "done" if study.finished else "stopped",
        "verdict": overall(study.rows),
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
