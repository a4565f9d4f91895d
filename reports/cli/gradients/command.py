"""``ocp gradients SCENE|FILE|RUN``: is a simulator's gradient through contact right?"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from dynamics.settings import read_value, settings_of
from ocp import store
from ocp.errors import interruptible
from ocp.gradients.worlds import GradientReport, ReportSettings
from ocp.jobs.gradients import WorldJob, count_saved, measure_worlds
from ocp.jobs.scheduling import Workers
from ocp.store.checkpoint import Checkpoint
from ocp.store.stored_run import StoredRun
from problems.gradient_scenes.cases import GradientCase, gradient_case
from problems.plugin import problem_of
from reports.cli import interrupt
from reports.cli.options.gradients import GradientsOptions
from reports.cli.request import check_outputs, parse_assignments
from reports.tables.gradients import gradients_table

PLAN_SAMPLES = "200"
"""Default number of samples of each smoothed gradient of a plan, which is slow to simulate."""
Request = tuple[GradientCase, WorldJob, Checkpoint]
"""Derivative and simulators, the job of every measurement, and the storage of finished ones."""


def check(options: GradientsOptions) -> Request:
    """Return the checked request: simulators that were tried near the nominal parameter, settings, and storage.

    Simulators that are compiled first are tried later.
    """
    texts = parse_assignments("-s", options.settings)
    values = {name: read_value(f"-s {name}", text, float) for name, text in texts.items()}
    source = _source(options)
    is_plan = isinstance(source, StoredRun)
    requested = {name: getattr(options, name) for name in ("tolerance", "samples", "refinements", "seed")}
    requested |= {"samples": PLAN_SAMPLES} if is_plan and "samples" not in options.explicit else {}
    declared = settings_of(ReportSettings)
    settings = ReportSettings(**{name: declared[name].read(value, "--") for name, value in requested.items()})
    worlds, entries = tuple(options.worlds or ()), (options.parameter, options.component)
    judged = source.solution(problem_of(source, options.problem_from_source([source]))[2]) if is_plan else source
    case = gradient_case(judged, worlds, values, *entries, options.seed)
    for world in case.worlds:
        if world.compile is None:
            case.questions[0].check(world)
    check_outputs(options.out, options.pdf)
    request = source.path if is_plan else source, worlds, values, *entries, options.source, settings, case.content
    record = _record(options, case, settings)
    return case, WorldJob(*request), Checkpoint(options.out, case.name, record, case.content)


def _source(options: GradientsOptions) -> str | StoredRun:
    """Return the name of a scene or a file, or the run of a solve that the user names."""
    if not options.scene.startswith("@") and not Path(options.scene).is_dir():
        return options.scene
    run = options.stored(options.scene)
    run.check_solve()
    return run


def run(options: GradientsOptions, request: Request) -> int:
    """Measure all simulators, store the report, and print the table and the verdicts."""
    case, job, checkpoint = request
    output, count = options.output, len(case.questions) * len(case.worlds)

    def announce(index: int, text: str) -> None:
        interrupt.raise_if_interrupted()
        output.note(f"{index + 1} of {count}: {text}")

    with checkpoint, interruptible():
        for line in checkpoint.notes:
            output.say(line)
        if saved := count_saved(checkpoint, count):
            output.say(f"resumed; {saved} of {count} measurements already complete")
        workers = Workers(options.jobs, options.scheduler)
        try:
            report = measure_worlds(case.worlds, case.questions, job.settings, checkpoint, announce, workers, job)
        except KeyboardInterrupt:
            output.say(f"{count_saved(checkpoint, count)} of {count} measurements are kept; the same command resumes")
            raise
        meta = _meta(options, case, job.settings, report)
        stored = store.write_run(options.out, case.name, report.dataset(), meta)
        checkpoint.discard()
    output.note(gradients_table(meta["worlds"]))
    output.say(meta["verdict"])
    output.finish(stored, meta, options.pdf)
    return 0


def _record(options: GradientsOptions, case: GradientCase, settings: ReportSettings) -> dict[str, Any]:
    """Return the values that determine the result, as the run stores them."""
    return {
        "worlds": {world.name: dict(world.settings) for world in case.worlds},
        "tolerance": settings.tolerance,
        "samples": settings.samples,
        "refinements": settings.refinements,
        "seed": settings.seed,
        "theta": list(case.questions[0].theta),
        "size": case.questions[0].size,
        "plan": case.plan or None,
        "source": options.scene if options.scene.endswith(".py") else None,
    }


def _meta(
    options: GradientsOptions, case: GradientCase, settings: ReportSettings, report: GradientReport
) -> dict[str, Any]:
    """Return the metadata of the run to be stored."""
    parameter, output = ({"name": signal.name, "unit": signal.unit} for signal in case.questions[0].signals)
    return {
        "kind": "gradients",
        "argv": options.argv,
        "tags": options.tags,
        "seed": settings.seed,
        "record": _record(options, case, settings),
        "source_digest": case.content or None,
        "title": case.title,
        "parameter": parameter,
        "output": output,
        "worlds": report.rows,
        "status": "done" if all(row["status"] == "done" for row in report.rows) else "partly failed",
        "verdict": "\n".join(report.sentences),
    }
