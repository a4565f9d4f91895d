"""``ocp estimate PROBLEM``: gradient estimators held against what is known."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from reports.cli import interrupt
from reports.cli.choices import BACKENDS
from reports.cli.common import (
    Contact,
    Debug,
    Json,
    LawSettings,
    Out,
    Output,
    Params,
    PolicyName,
    Quiet,
    Seed,
    Settings,
)

if TYPE_CHECKING:
    from ocp.gradients.sweep import SweepRun
    from reports.cli.estimate_request import EstimateRequest


def run(
    problem: Annotated[str, typer.Argument(help="Registered name or path/to/file.py.")],
    estimators: Annotated[
        str, typer.Option("--estimators", help="Names with commas; ocp list shows them.")
    ] = "zobg,fobg,alpha",
    samples: Annotated[str, typer.Option("--samples", "-n", help="Of each estimator.")] = "1e5",
    sweep: Annotated[
        str | None, typer.Option("--sweep", metavar="NAME=A:B:n[:log]", help="Go along NAME.")
    ] = None,
    sigma: Annotated[float | None, typer.Option("--sigma", help="Size of the noise.")] = None,
    params: Params = None,
    contact: Contact = "barrier",
    law_settings: LawSettings = None,
    policy: PolicyName = "open-loop",
    settings: Settings = None,
    reference: Annotated[
        str,
        typer.Option("--reference", help="auto, closed-form, quadrature, zobg or none."),
    ] = "auto",
    reference_samples: Annotated[
        str | None, typer.Option("--reference-samples", help="Of a sampled reference.")
    ] = None,
    at: Annotated[
        Path | None, typer.Option("--at", help="A stored run whose inputs are the decision.")
    ] = None,
    backend: Annotated[
        str, typer.Option("--backend", help=f"{', '.join(BACKENDS[:-1])} or {BACKENDS[-1]}.")
    ] = "auto",
    threads: Annotated[int | None, typer.Option("--threads", min=1, help="CPUs to use.")] = None,
    seed: Seed = 0,
    out: Out = Path("runs"),
    pdf: Annotated[Path | None, typer.Option("--pdf", help="Write a report here.")] = None,
    as_json: Json = False,
    quiet: Quiet = False,
    debug: Debug = False,
) -> int:
    """Estimate the gradient of a smoothed objective, several ways, and judge each.

    The cost of an objective, or of a problem's rollout, is averaged over Gaussian noise on the
    decision or on the inputs. What is done is kept: the same command goes on after Ctrl-C.
    """
    from ocp import store
    from ocp.gradients.sweep import SweepRun
    from ocp.store.checkpoint import Checkpoint
    from ocp.store.provenance import versions
    from reports import estimates
    from reports.cli.estimate_request import EstimateRequest
    from reports.cli.request import check_pdf_place

    engine = {"backend": backend, "threads": threads}
    asked = EstimateRequest.read(
        problem=problem, params=params, contact=contact, law_settings=law_settings,
        policy_name=policy, settings=settings, estimators=estimators, samples=samples, sigma=sigma,
        sweep=sweep, seed=seed, reference=reference, reference_samples=reference_samples, at=at,
        engine=engine,
    )  # fmt: skip
    store.check_writable(out)
    check_pdf_place(pdf)
    output = Output(as_json, quiet)
    identity = {**asked.record, "backend": backend, "by": versions()}
    checkpoint = Checkpoint(out, asked.name, identity)
    study = SweepRun(asked.objective, asked.sampling, asked.sweep, checkpoint, asked.rebuilt)
    interrupted = False
    try:
        with estimates.progress(quiet, interrupt.check) as report:
            study.run(report)
    except KeyboardInterrupt:
        if not study.rows:
            raise
        interrupted = True
    meta, path = _store(asked, study, out)
    if study.finished:
        checkpoint.discard()
    output.note(
        estimates.table(meta["estimates"], None if sweep is None else meta["sweep"]["name"])
    )
    if study.resumed:
        output.say(f"went on from {study.resumed} points that were done before")
    output.say(meta["verdict"])
    output.say(f"run: {path}")
    if pdf is not None:
        from reports.pdf import write_pdf

        write_pdf([store.load(path)], pdf)
        output.say(f"PDF: {pdf}")
    output.document({**meta, "run": str(path), "pdf": None if pdf is None else str(pdf)})
    if interrupted:
        raise KeyboardInterrupt
    return 0


def _store(asked: EstimateRequest, study: SweepRun, out: Path) -> tuple[dict[str, Any], Path]:
    """Write the finished points as a run and return its description and directory."""
    from ocp import store
    from ocp.gradients.sweep import overall, sweep_dataset

    data = sweep_dataset(study.widest, study.rows, asked.sweep, asked.unit())
    swept = asked.sweep
    meta = {
        "kind": "estimate",
        "argv": ["ocp", *sys.argv[1:]],
        "problem": asked.name,
        "seed": asked.sampling.seed,
        "record": asked.record,
        "sweep": None if swept is None else {
            "name": swept.name, "values": list(swept.values), "unit": asked.unit(),
            "log": swept.log,
        },
        "estimates": [row for point in study.rows for row in point],
        "status": "done" if study.finished else "stopped",
        "verdict": overall(study.rows),
    }  # fmt: skip
    return meta, store.write(out, asked.name, data, meta)
