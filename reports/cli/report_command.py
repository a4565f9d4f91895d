"""``ocp report RUN... -o FILE.pdf``: a PDF from stored runs."""

from __future__ import annotations

from dataclasses import MISSING, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from reports.cli.options import Command, SourceOptions, argument, option

if TYPE_CHECKING:
    from ocp.store.stored_run import StoredRun
    from problems.spec import ProblemSpec

    ReportRequest = tuple[list[StoredRun], ProblemSpec | None]


@dataclass(frozen=True, kw_only=True)
class ReportOptions(SourceOptions):
    """The runs, and the file."""

    runs: list[str] = argument(help="Runs: paths, or parts of their names.")
    pdf: Path = option(MISSING, "--output", "-o", help="The PDF to write.")
    cones: bool = option(False, "--cones", help="Draw friction cones at the contact forces.")

    @property
    def named_runs(self) -> list[str]:
        """Runs that the command reads, as given."""
        return self.runs


def check(options: ReportOptions) -> ReportRequest:
    """Read the runs, and the problem's file if one is given."""
    from reports.cli.request import check_place
    from reports.cli.runs_command import stored

    check_place(options.pdf, "PDF")
    runs = [stored(text, options.out) for text in options.runs]
    return runs, options.own(runs)


def run(options: ReportOptions, request: ReportRequest) -> int:
    """Write a PDF of one stored run, or of several side by side."""
    from reports.pdf import write_pdf

    runs, own = request
    write_pdf(runs, options.pdf, options.cones, own)
    output = options.output
    output.say(f"PDF: {options.pdf}")
    output.document({"pdf": str(options.pdf), "runs": [str(item.path) for item in runs]})
    return 0


COMMAND = Command(
    ReportOptions,
    check,
    run,
    examples=(
        "report @last -o report.pdf",
        "report @2 @last -o both.pdf",
    ),
)
