"""Commands of ``ocp``, each a class of options whose docstring is the command's help."""

from __future__ import annotations

from dataclasses import MISSING
from pathlib import Path
from typing import ClassVar

from dynamics.limits import CONTINUATION_STEPS, WORKERS
from reports.cli.options.gradients import GradientsOptions
from reports.cli.options.learning import CollectOptions, EvaluateOptions, LearnOptions, TrainOptions
from reports.cli.options.mpc import MpcOptions
from reports.cli.options.output import AnimateOptions, CompareOptions, ExportOptions, FigureOptions, ReportOptions
from reports.cli.options.shared import (
    LAW_HELP,
    PROBLEM_HELP,
    JobsOptions,
    LawOptions,
    Options,
    PolicyOptions,
    RunOptions,
    SolverOptions,
    SourceOptions,
    StartsOptions,
    argument,
    assignment,
    option,
)
from reports.cli.options.store import RmOptions, RunsExportOptions, RunsOptions

BACKENDS = ("auto", "c", "numpy", "casadi")
"""Engines of batched evaluation; auto is the first of the others that can be built."""


class ListOptions(Options):
    """List named problems, arena tasks, algorithms, contact laws, methods, policies, solvers, figures."""

    code: ClassVar = "reports.cli.list_command:list"
    examples: ClassVar = ("list", "list arena", "list --json")
    kind: str | None = argument(None, help="Only this kind, for example problems or arena.")


class SettingsOptions(Options):
    """List methods, strategies, policies, laws and all settings of -s and -c, with default and meaning.

    IPOPT's options are listed where our default differs from IPOPT's; ocp settings ipopt has all.
    """

    code: ClassVar = "reports.cli.list_command:settings"
    examples: ClassVar = ("settings", "settings strategies", "settings ipopt", "settings tol")
    word: str | None = argument(
        None,
        help="methods, strategies, laws, estimators or training; one law (its name or a file),"
        " policy, solver, estimator or algorithm; or the name of a setting.",
    )


FLOATING = "For a URDF: let its root move freely in space."
"""Help text of ``--floating``."""
PLANAR = "For a URDF: let its root move freely in the plane of its joints."
"""Help text of ``--planar``."""
FOLDER = "Open no file outside this folder, which contains the robot's file."
"""Help text of ``--folder``."""


class ShowOptions(Options):
    """Show a problem: equations, parameters with units and defaults, citation, golden values.

    A learning task of the same name is also shown. For data and models: origin, ranges, scales, and
    the quality of the fit. For a robot: its links, motors and contacts, and the parts of its file
    that are not used.
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
    """Write NAME.py, a commented file of a problem, or of a simulator with --world, that works and can be edited."""

    code: ClassVar = "reports.cli.new_command"
    examples: ClassVar = (
        "new bumper",
        "new push-box --scene",
        "new leg --machine",
        "new sim --world",
        "new hop --robot robot.xml --task jump",
    )
    problem: str = argument(metavar="NAME", help="Name of the problem and of its file.")
    scene: bool = option(False, help="Build the system from bodies and pushers with shapes.")
    machine: bool = option(False, help="Build a machine of links, joints and motors over the ground.")
    world: bool = option(False, help="Wrap a simulator whose gradient ocp gradients judges.")
    robot: Path | None = option(None, metavar="FILE", help="Move the robot of a URDF or MJCF file to another pose.")
    task: str | None = option(None, metavar="TASK", help="What the robot does: stand, reach, walk, jump or push.")
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
        "solve push-disc --contact exact --guess sketch.toml",
        "solve push-disc --contact exact --starts 8 --jobs 2 --rank exact",
        "solve cart-walls --contact exact --until survives",
        "solve model.nl",
    )
    problem: str = argument(help=f"{PROBLEM_HELP[:-1]}, or a .nl file of AMPL, Pyomo or JuMP.")
    start: str | None = option(None, "--from", metavar="RUN", help="Start from a stored run of the same problem.")
    guess: str | None = option(
        None, metavar="RUN|FILE", help="Begin at a run, or at keyframes, paths, contacts of a .json or .toml file."
    )
    require: str | None = option(None, metavar="survives", help="Exit 3 unless the plan survives the referee.")
    effort: str = option(
        "normal",
        metavar="LEVEL|STEPS",
        help="Work beyond the usual route: quick, normal, thorough, or steps to sample.",
    )
    search: bool | None = option(
        None,
        "--search/--no-search",
        help="Search for plans thoroughly, or not at all.",
    )
    refine: bool = option(False, help="Solve again at h/2, h/4, ... until the cost converges.")
    until: str | None = option(
        None,
        metavar="survives",
        help="Try more exact contact, finer steps, gains, a controller until the plan survives.",
    )
    world: str | None = option(None, help="Also replay the plan in another simulator: mujoco.")
    sensitivity: list[str] | None = option(
        None, metavar="NAME", help="Derivative of the optimal cost and of replays by a parameter."
    )
    plot: Path | None = option(None, metavar="FILE", help="Draw the solution to a .pdf, .svg or .png file.")


class ReplayOptions(RunOptions, LawOptions, SourceOptions):
    """Simulate the inputs, or the feedback policy, of a stored run under a law or in MuJoCo."""

    code: ClassVar = "reports.cli.solve_command:replay"
    examples: ClassVar = ("replay @last", "replay @last --contact barrier -c mu=1e-2", "replay @last --world mujoco")
    contact: str = option("exact", help=LAW_HELP)
    world: str | None = option(None, help="Simulate in mujoco instead of under a law.")
    settings: list[str] | None = assignment(
        "--setting", "-s", help="Setting of mujoco: solref, time constant of contact [s], or h, longest step [s]."
    )


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
    steps: int = option(20, limits=CONTINUATION_STEPS, help="Number of steps.")
    scale: str = option("linear", help="log or linear.")


class SweepOptions(StartsOptions):
    """Solve a problem at every point of a grid, in parallel processes or on a Dask cluster.

    Each point has the answer of ocp solve, unless the plan of a neighbouring point is better there;
    such points are marked as outliers. Finished points are kept: after Ctrl-C or a kill the same
    command resumes, with the same result as without the stop.
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


class EstimateOptions(JobsOptions, PolicyOptions):
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
    threads: int | None = option(None, limits=WORKERS, help="CPUs to use.")


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
    "arena compare": CompareOptions,
    "replay": ReplayOptions,
    "mpc": MpcOptions,
    "continue": ContinueOptions,
    "sweep": SweepOptions,
    "estimate": EstimateOptions,
    "gradients": GradientsOptions,
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
"""Mapping from the name of each command, which may have two words, to its class of options."""
