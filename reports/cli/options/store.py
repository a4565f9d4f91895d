"""Options of ``ocp runs``, ``ocp runs rm`` and ``ocp runs export``."""

from __future__ import annotations

from dataclasses import MISSING
from pathlib import Path
from typing import ClassVar

from dynamics.limits import COUNT
from reports.cli.options.shared import RUN_HELP, RunOptions, StoreOptions, argument, option


class RunsOptions(StoreOptions):
    """List the stored runs, the latest last, or show one.

    Commands accept the number before a run as its name: @1, or @last, is the latest.
    """

    code: ClassVar = "reports.cli.runs_command"
    examples: ClassVar = (
        "runs",
        "runs @last",
        "runs --problem push-disc --contact barrier --since 2h",
        "runs --tag paper --status survives --json",
        "runs rm @2",
        "runs export @last -o motion.csv",
    )
    run: str | None = argument(None, help=RUN_HELP)
    problem: str | None = option(None, help="Only runs of this problem.")
    kind: str | None = option(None, help="Only this kind: solve, continue, estimate, train, ...")
    contact: str | None = option(None, help="Only runs under this contact law.")
    method: str | None = option(None, help="Only runs by this method.")
    algorithm: str | None = option(None, help="Only policies trained by this algorithm.")
    status: str | None = option(None, help="Only this status: solved, survives, interrupted, damaged, ...")
    tags: list[str] | None = option(
        None, "--tag", metavar="WORD", help="Only runs with this tag; repeat for several, all of which must match."
    )
    since: str | None = option(None, metavar="WHEN", help="Only runs since a date (2026-01-31) or in the last 2h, 7d.")
    last: int | None = option(None, "-n", limits=COUNT, metavar="N", help="The last N matching runs; 100 if not given.")


class RmOptions(StoreOptions):
    """Delete stored runs, damaged ones included; nothing is deleted unless every name is a run."""

    code: ClassVar = "reports.cli.runs_command:rm"
    examples: ClassVar = ("runs rm @last", "runs rm @2 @3 @4")
    runs: list[str] = argument(metavar="RUN...", help="Runs: paths, parts of their names, or numbers such as @2.")


class RunsExportOptions(RunOptions):
    """Write the arrays of a stored run to a file for other programs.

    A CSV file has one row per scenario and node of a solve, per point, scenario and node of a continuation, per
    point and estimator of an estimate, or per iteration of a training; its header has the units. An NPZ file
    has every array under its name, and the run's description as JSON in meta.
    """

    code: ClassVar = "reports.cli.runs_command:export"
    examples: ClassVar = ("runs export @last -o motion.csv", "runs export push-disc -o push.npz")
    file: Path = option(MISSING, "--output", "-o", help="The file to write.")
    form: str | None = option(None, "--format", metavar="csv|npz", help="csv or npz; default: by the file's name.")
