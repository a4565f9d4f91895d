"""Options of the commands that write figures, reports, animations and C files, and compare results."""

from __future__ import annotations

from dataclasses import MISSING
from pathlib import Path
from typing import ClassVar

from dynamics.limits import INDEX
from reports.cli.options.shared import (
    JobsOptions,
    Options,
    RunOptions,
    SourceOptions,
    StoreOptions,
    argument,
    assignment,
    option,
)


class FigureOptions(JobsOptions, StoreOptions):
    """Run a study, store it, draw it to ID.pdf, write its data to ID.nc, and check its claims.

    With --format or --panel the bare figure is written as well, for a paper: ID-figure.pdf, or
    ID-a.pdf for panel a. A stored run is drawn again without any computation.
    """

    code: ClassVar = "reports.cli.figure_command"
    examples: ClassVar = ("figure A1", "figure --all --quick -j 4", "figure P3 P6 --format svg --panel b")
    figures: list[str] | None = argument(None, help="Figures, such as P6 (ocp list), or stored runs to draw again.")
    every: bool = option(False, "--all", help="All figures.")
    quick: bool = option(False, help="Smaller sizes for long studies.")
    params: list[str] | None = assignment("--param", "-p", help="Parameter of the study.")
    seed: int = option(0, limits=INDEX, help="Random seed.")
    ending: str | None = option(None, "--format", metavar="pdf|svg|png", help="Also write the bare figure for a paper.")
    panel: str | None = option(None, metavar="a", help="Only this panel of the bare figure, one column wide.")

    @property
    def named_runs(self) -> list[str]:
        """Arguments that are stored runs, as paths, ``@last`` or ``@2``, and not studies."""
        return [name for name in self.figures or () if name.startswith("@") or "/" in name]


class ReportOptions(SourceOptions):
    """Write a PDF of one stored run, or of several side by side."""

    code: ClassVar = "reports.cli.report_command:report"
    examples: ClassVar = ("report @last -o report.pdf", "report @2 @last -o both.pdf")
    runs: list[str] = argument(help="Runs: paths, or parts of their names.")
    pdf: Path = option(MISSING, "--output", "-o", help="The PDF to write.")
    cones: bool = option(False, help="Draw friction cones at the contact forces.")
    signals: str | None = option(
        None, metavar="NAME,...", help="Draw only these signals of a solve over time; * matches any text."
    )


class AnimateOptions(RunOptions, SourceOptions):
    """Animate a stored run: bodies and contact forces of the plan and of its exact replay."""

    code: ClassVar = "reports.cli.report_command:animate"
    examples: ClassVar = ("animate @last -o motion.gif", "animate push-disc -o push.html --speed 0.5")
    file: Path = option(MISSING, "--output", "-o", help="The .gif, .mp4 or .html file to write.")
    fps: int = option(25, limits={"least": 1, "most": 100}, help="Frames per second.")
    speed: float = option(1.0, limits={"least": 1e-3, "most": 1e3}, help="1 is real time, 0.5 half speed.")
    repeat: int = option(1, limits={"least": 1, "most": 100}, help="Show a periodic motion, a stride, n times.")
    cones: bool = option(False, help="Draw friction cones.")


class ExportOptions(SourceOptions):
    """Write one step of a problem, its derivatives and a run's policy as one C11 file.

    The policy of a closed loop of ocp mpc is its gains, one row per sample: those of phase policy, or of the
    regulator along the last plan.
    """

    code: ClassVar = "reports.cli.export_command"
    examples: ClassVar = ("export push-disc --contact barrier -c mu=1e-3 -o step.c", "export @last -o policy.c")
    subject: str = argument(
        metavar="RUN|PROBLEM", help="A run: its path, or part of its name; or a problem: its name or file."
    )
    file: Path = option(MISSING, "--output", "-o", help="The C file to write.")
    params: list[str] | None = assignment("--param", "-p", help="Parameter of the problem.")
    contact: str | None = option(None, help="Contact law; default: that of the run, or exact.")
    law_settings: list[str] | None = assignment("--contact-setting", "-c", help="Setting of the contact law.")

    @property
    def named_runs(self) -> list[str]:
        """The argument as a list of one run; empty if it is the name or file of a problem."""
        from problems import names

        return [] if self.subject in names() or self.subject.endswith(".py") else [self.subject]


class CompareOptions(Options):
    """Put results on arena tasks beside those of ocp solve and the published ones.

    The file has a line for each result: task, instance (empty for a task without instances), cost, and, if you
    like, solved (true or false), iterations and seconds. lower, equal and higher count the solved instances by their
    cost, compared with a certified one of ocp solve.
    """

    code: ClassVar = "reports.cli.arena_command:compare"
    examples: ClassVar = ("arena compare results.csv", "arena compare results.csv --json")
    file: Path = argument(metavar="FILE.csv", help="Results, with a header: task,instance,cost,...")
