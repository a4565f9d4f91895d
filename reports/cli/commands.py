"""The commands: each a class of options whose docstring is the command's help."""

from __future__ import annotations

from dataclasses import MISSING
from pathlib import Path
from typing import ClassVar

from reports.cli.learning.options import (
    CollectOptions,
    EvaluateOptions,
    LearnOptions,
    TrainOptions,
)
from reports.cli.mpc_options import MpcOptions
from reports.cli.options import (
    LAW_HELP,
    PROBLEM_HELP,
    RUN_HELP,
    JobsOptions,
    LawOptions,
    Options,
    ProblemOptions,
    RunOptions,
    SolverOptions,
    SourceOptions,
    StartsOptions,
    StoreOptions,
    argument,
    assignment,
    option,
)

BACKENDS = ("auto", "c", "numpy", "casadi")
"""Engines of batched evaluation; auto takes the first that can be built."""


class ListOptions(Options):
    """List named problems, tasks, algorithms, contact laws, methods, policies, solvers, figures."""

    code: ClassVar = "reports.cli.list_command:list"
    examples: ClassVar = ("list", "list --json")


class SettingsOptions(Options):
    """List methods, strategies, policies, laws and every setting of -s and -c: default, meaning.

    IPOPT's options are listed where our default differs from IPOPT's; ocp settings ipopt has all.
    """

    code: ClassVar = "reports.cli.list_command:settings"
    examples: ClassVar = ("settings", "settings strategies", "settings ipopt", "settings tol")
    word: str | None = argument(
        None,
        help="methods, strategies, laws, estimators or training; one law (its name or a file),"
        " policy, solver, estimator or algorithm; or the name of a setting.",
    )


FLOATING = "Of a URDF: its root moves freely in space."
"""Help of ``--floating``."""
PLANAR = "Of a URDF: its root moves freely in the plane of its joints."
"""Help of ``--planar``."""
FOLDER = "A folder around the robot's file, out of which nothing is opened."
"""Help of ``--folder``."""


class ShowOptions(Options):
    """Show a problem: equations, parameters with units and defaults, citation, golden values.

    A learning task of the same name is shown too. For data and models: origin, ranges, scales, and
    the quality of the fit. For a robot: its links, motors and contacts, and what of its file is not
    used.
    """

    code: ClassVar = "reports.cli.list_command:show"
    examples: ClassVar = ("show push-disc", "show data.nc", "show robot.xml")
    problem: str = argument(
        metavar="PROBLEM|FILE",
        help=f"{PROBLEM_HELP[:-1]}, a .nc file of ocp collect or ocp learn, or a URDF or MJCF file.",
    )
    floating: bool = option(False, help=FLOATING)
    planar: bool = option(False, help=PLANAR)
    folder: Path | None = option(None, metavar="DIR", help=FOLDER)


class NewOptions(Options):
    """Write NAME.py, a commented problem file to begin with, which solves as it is."""

    code: ClassVar = "reports.cli.new_command"
    examples: ClassVar = (
        "new bumper",
        "new push-box --scene",
        "new leg --machine",
        "new hop --robot robot.xml",
    )
    problem: str = argument(metavar="NAME", help="Name of the problem and of its file.")
    scene: bool = option(False, help="Bodies and pushers of shapes, in place of distances by hand.")
    machine: bool = option(False, help="Links with joints and motors over the ground.")
    robot: Path | None = option(None, metavar="FILE", help="A robot of a URDF or MJCF file, to another pose.")
    floating: bool = option(False, help=FLOATING)
    planar: bool = option(False, help=PLANAR)
    folder: Path | None = option(None, metavar="DIR", help=FOLDER)


class SolveOptions(StartsOptions):
    """Solve a problem under a contact law, audit the answer, and store the run."""

    code: ClassVar = "reports.cli.solve_command"
    examples: ClassVar = (
        "solve push-disc",
        "solve push-disc -p M=2 -p N=40 --contact exact --pdf plan.pdf",
        "solve push-disc --contact adaptive -c sigma=0.05 -s tol=1e-8 --tag soft",
        "solve push-disc -p goal_x=0.5 --from @last",
        "solve push-disc --contact exact --starts 8 --jobs 2 --rank exact",
    )
    start: str | None = option(None, "--from", metavar="RUN", help="Start from a stored run of the same problem.")
    require: str | None = option(None, metavar="survives", help="Exit 3 unless the plan survives the referee.")
    search: bool | None = option(
        None,
        "--search/--no-search",
        help="Search over pushes from nothing; by default for a scene whose answer falls short.",
    )
    refine: bool = option(False, help="Solve again at h/2, h/4, ... until the cost converges.")
    world: str | None = option(None, help="Try the plan in another simulator too: mujoco.")
    sensitivity: list[str] | None = option(
        None, metavar="NAME", help="Differentiate the optimal cost by a parameter, replays too."
    )
    plot: Path | None = option(None, metavar="FILE", help="Draw the solution to a .pdf, .svg or .png file.")


class ReplayOptions(RunOptions, LawOptions, SourceOptions):
    """Simulate the inputs, or the feedback policy, of a stored run under a law or in MuJoCo."""

    code: ClassVar = "reports.cli.solve_command:replay"
    examples: ClassVar = (
        "replay @last",
        "replay @last --contact barrier -c mu=1e-2",
        "replay @last --world mujoco",
    )
    contact: str = option("exact", help=LAW_HELP)
    world: str | None = option(None, help="Another simulator in place of a law: mujoco.")


class ContinueOptions(SolverOptions):
    """Continue a solution along a parameter of problem, law or start, and store the path."""

    code: ClassVar = "reports.cli.sweep_command:continue"
    examples: ClassVar = (
        "continue push-1d --contact barrier --over mu --from 1e-1 --to 1e-5",
        "continue push-1d --over M --from 1 --to 2 --pdf path.pdf",
    )
    over: str = option(MISSING, help="Parameter, such as contact.mu or M.")
    start: float = option(MISSING, "--from", help="First value.")
    end: float = option(MISSING, "--to", help="Last value.")
    steps: int = option(20, min=1, max=100_000, help="Number of steps.")
    scale: str = option("linear", help="log or linear.")


class SweepOptions(StartsOptions):
    """Solve a problem at every point of a grid, over processes or a Dask cluster.

    Each point is what ocp solve gives there, unless a neighbour's plan is better; such outliers are
    named. Finished points are kept: after Ctrl-C or a kill the
    same command resumes, with the same result as without the stop.
    """

    code: ClassVar = "reports.cli.sweep_command"
    examples: ClassVar = (
        "sweep push-disc --over M=0.5:2:7 --over h=0.05:0.1:3 -j 2",
        "sweep push-1d --contact barrier --over mu=1e-3:1e-1:5:log --pdf sweep.pdf",
    )
    over: list[str] | None = option(
        None,
        metavar="NAME=A:B:n[:log]",
        help="Values of a parameter, a law setting (contact.mu), a setting (setting.tol).",
    )


class EstimateOptions(JobsOptions, ProblemOptions):
    """Estimate the gradient of a smoothed objective with several estimators, and judge each.

    The cost of an objective, or of a problem's rollout, is averaged over Gaussian noise on the
    decision or on the inputs. Finished points are kept: after Ctrl-C the same command resumes.
    """

    code: ClassVar = "reports.cli.estimate_command"
    examples: ClassVar = (
        "estimate heaviside --samples 1e5 --sweep sigma=0.01:1:9:log",
        "estimate push-1d --contact exact --estimators zobg,alpha -s alpha.gamma=1",
    )
    contact: str = option("barrier", help=LAW_HELP)
    estimators: str = option("zobg,fobg,alpha", help="Names separated by commas; list with ocp list.")
    samples: str = option("1e5", "-n", help="Samples per estimator.")
    sweep: str | None = option(None, metavar="NAME=A:B:n[:log]", help="Sweep over NAME.")
    sigma: float | None = option(None, help="Standard deviation of the noise.")
    reference: str = option("auto", help="auto, closed-form, quadrature, zobg or none.")
    reference_samples: str | None = option(None, help="Samples of a sampled reference.")
    decision_run: str | None = option(None, "--at", help="Stored run whose inputs are the decision.")
    backend: str = option("auto", help=f"{', '.join(BACKENDS[:-1])} or {BACKENDS[-1]}.")
    threads: int | None = option(None, min=1, max=1024, help="CPUs to use.")


class FigureOptions(JobsOptions, StoreOptions):
    """Run a study, store it, draw it as ID.pdf beside its data ID.nc, and check its claims.

    With --format or --panel the bare figure is written as well, for a paper: ID-figure.pdf, or
    ID-a.pdf for panel a. A stored run is drawn again without any computation.
    """

    code: ClassVar = "reports.cli.figure_command"
    examples: ClassVar = (
        "figure A1",
        "figure --all --quick -j 4",
        "figure P3 P6 --format svg --panel b",
    )
    figures: list[str] | None = argument(None, help="Figures, such as P6 (ocp list), or stored runs to draw again.")
    every: bool = option(False, "--all", help="All figures.")
    quick: bool = option(False, help="Smaller sizes for long studies.")
    params: list[str] | None = assignment("--param", "-p", help="Parameter of the study.")
    seed: int = option(0, min=0, help="Random seed.")
    ending: str | None = option(None, "--format", metavar="pdf|svg|png", help="Also write the bare figure for a paper.")
    panel: str | None = option(None, metavar="a", help="Only this panel of the bare figure, one column wide.")

    @property
    def named_runs(self) -> list[str]:
        """Arguments that name stored runs, as paths, ``@last`` or ``@2``, rather than studies."""
        return [name for name in self.figures or () if name.startswith("@") or "/" in name]


class ReportOptions(SourceOptions):
    """Write a PDF of one stored run, or of several side by side."""

    code: ClassVar = "reports.cli.report_command:report"
    examples: ClassVar = ("report @last -o report.pdf", "report @2 @last -o both.pdf")
    runs: list[str] = argument(help="Runs: paths, or parts of their names.")
    pdf: Path = option(MISSING, "--output", "-o", help="The PDF to write.")
    cones: bool = option(False, help="Draw friction cones at the contact forces.")
    signals: str | None = option(
        None, metavar="NAME,...", help="Draw only these signals of a solve over time; * is a joker."
    )


class AnimateOptions(RunOptions, SourceOptions):
    """Animate a stored run: bodies and contact forces of the plan and of its exact replay."""

    code: ClassVar = "reports.cli.report_command:animate"
    examples: ClassVar = (
        "animate @last -o motion.gif",
        "animate push-disc -o push.html --speed 0.5",
    )
    file: Path = option(MISSING, "--output", "-o", help="The .gif, .mp4 or .html file to write.")
    fps: int = option(25, min=1, max=100, help="Frames per second.")
    speed: float = option(1.0, min=1e-3, max=1e3, help="1 is real time, 0.5 half speed.")
    repeat: int = option(1, min=1, max=100, help="Show a periodic motion, a stride, n times.")
    cones: bool = option(False, help="Draw friction cones.")


class ExportOptions(SourceOptions):
    """Write one step of a problem, its derivatives and a run's policy as one C11 file."""

    code: ClassVar = "reports.cli.export_command"
    examples: ClassVar = (
        "export push-disc --contact barrier -c mu=1e-3 -o step.c",
        "export @last -o policy.c",
    )
    subject: str = argument(
        metavar="RUN|PROBLEM",
        help="A run: its path, or part of its name; or a problem: its name or file.",
    )
    file: Path = option(MISSING, "--output", "-o", help="The C file to write.")
    params: list[str] | None = assignment("--param", "-p", help="Parameter of the problem.")
    contact: str | None = option(None, help="Contact law; default: that of the run, or exact.")
    law_settings: list[str] | None = assignment("--contact-setting", "-c", help="Setting of the contact law.")

    @property
    def named_runs(self) -> list[str]:
        """The argument as a list, empty where it is the name or file of a problem."""
        from problems import names

        return [] if self.subject in names() or self.subject.endswith(".py") else [self.subject]


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
        None,
        "--tag",
        metavar="WORD",
        help="Only runs with this tag; repeat for several, all of which must match.",
    )
    since: str | None = option(None, metavar="WHEN", help="Only runs since a date (2026-01-31) or in the last 2h, 7d.")
    last: int | None = option(None, "-n", min=1, metavar="N", help="The last N matching runs; 100 if not given.")


class RmOptions(StoreOptions):
    """Delete stored runs, damaged ones too; nothing is deleted unless every name is a run."""

    code: ClassVar = "reports.cli.runs_command:rm"
    examples: ClassVar = ("runs rm @last", "runs rm @2 @3 @4")
    runs: list[str] = argument(metavar="RUN...", help="Runs: paths, parts of their names, or numbers such as @2.")


class RunsExportOptions(RunOptions):
    """Write the arrays of a stored run to a file for other programs.

    CSV has one row per scenario and node of a solve, per point, scenario and node of a
    continuation, per point and estimator of an estimate, per iteration of a training; its header
    has the units. NPZ has every array by name, and the run's description as JSON in meta.
    """

    code: ClassVar = "reports.cli.runs_command:export"
    examples: ClassVar = ("runs export @last -o motion.csv", "runs export push-disc -o push.npz")
    file: Path = option(MISSING, "--output", "-o", help="The file to write.")
    form: str | None = option(None, "--format", metavar="csv|npz", help="csv or npz; default: by the file's name.")


class DoctorOptions(Options):
    """Show CasADi's plugins, the compiler, threads, versions, and the location of the packages."""

    code: ClassVar = "reports.cli.doctor_command"
    examples: ClassVar = ("doctor", "doctor --json")
    clear_cache: bool = option(False, help="Clear the cache of compiled kernels first.")


COMMANDS: dict[str, type[Options]] = {
    "list": ListOptions,
    "settings": SettingsOptions,
    "show": ShowOptions,
    "new": NewOptions,
    "solve": SolveOptions,
    "replay": ReplayOptions,
    "mpc": MpcOptions,
    "continue": ContinueOptions,
    "sweep": SweepOptions,
    "estimate": EstimateOptions,
    "collect": CollectOptions,
    "learn": LearnOptions,
    "train": TrainOptions,
    "evaluate": EvaluateOptions,
    "figure": FigureOptions,
    "report": ReportOptions,
    "animate": AnimateOptions,
    "export": ExportOptions,
    "runs": RunsOptions,
    "runs rm": RmOptions,
    "runs export": RunsExportOptions,
    "doctor": DoctorOptions,
}
"""The options of every command by its name, which may have two words."""
