"""Options of the commands that collect data, and train models and policies."""

from __future__ import annotations

from dataclasses import MISSING
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from dynamics.limits import COUNT, EPISODES, INDEX, WORKERS
from reports.cli.options.shared import (
    LAW_HELP,
    PROBLEM_HELP,
    JobsOptions,
    LawOptions,
    RunOptions,
    TagOptions,
    argument,
    assignment,
    option,
)

if TYPE_CHECKING:
    from dynamics.settings import Range

SEEDS: Range = {"least": 1, "most": 1000}
"""Range of the number of seeds of a training."""
NOISE = 0.2
"""Default noise of a learned model, in standard deviations of the data."""


class CollectOptions(JobsOptions):
    """Sample transitions: draw inputs and penetration-free states, and take one step of the exact law.

    Half of the states are drawn in the problem's region, half near the line from start to goal.
    """

    code: ClassVar = "reports.cli.learning.learn_command:collect"
    examples: ClassVar = ("collect push-1d --samples 1e5 -o data.nc",)
    problem: str = argument(help=PROBLEM_HELP)
    file: Path = option(MISSING, "--output", "-o", help="The netCDF file to write.")
    params: list[str] | None = assignment("--param", "-p", help="Parameter of the problem.")
    samples: str = option("1e5", "-n", help="Number of transitions.")
    seed: int = option(0, limits=INDEX, help="Seed of the random draws.")


class LearnOptions(JobsOptions):
    """Learn a time step from transitions: a weighted average, or a network on noised inputs.

    A tenth of the rows is held out to measure the fit. The state of the training is kept: after
    Ctrl-C the same command resumes.
    """

    code: ClassVar = "reports.cli.learning.learn_command"
    examples: ClassVar = (
        "learn data.nc --model ewda -o model.nc",
        "learn data.nc --model mlp --hidden 64,64 --epochs 100 -o model.nc",
    )
    data: Path = argument(help="A file of ocp collect, a .csv or a .parquet.")
    model: str = option(MISSING, help="ewda or mlp.")
    file: Path = option(MISSING, "--output", "-o", help="The netCDF file to write.")
    noise: float = option(NOISE, help="sigma, in normalised units; 0: no noise (mlp).")
    hidden: str = option("128,128,128,128", help="Units of each hidden layer (mlp).")
    epochs: int = option(200, limits=COUNT, help="Largest number of epochs (mlp).")
    seed: int = option(0, limits=INDEX, help="Random seed.")
    seeds: int = option(1, limits=SEEDS, help="Number of networks, one per seed; the best is kept (mlp).")
    problem: str | None = option(None, help=f"Problem of the data. {PROBLEM_HELP}")
    columns: str | None = option(None, metavar="NAME=COLUMN,...", help="Column names in a table.")


class TrainOptions(LawOptions, TagOptions):
    """Train a policy through contact, with several algorithms and seeds in parallel.

    Every policy is evaluated under the exact law, and every training is stored as a run. After
    Ctrl-C the same command resumes, with the same result as without the stop.
    """

    code: ClassVar = "reports.cli.learning.train_command"
    examples: ClassVar = (
        "train ball-throw",
        "train hopper --algorithm fopg,ars --seeds 3 --iterations 200 --tag night",
    )
    task: str = argument(help="A named task.")
    algorithm: str = option("usual", "-a", help="Names separated by commas; usual: the default of the task.")
    contact: str = option("own", help="Contact law in training; own: adaptive for fopg, exact for others.")
    params: list[str] | None = assignment("--param", "-p", help="Parameter of the task.")
    settings: list[str] | None = assignment(
        "--setting", "-s", help="Setting of all algorithms, or of one: ars.rate=0.1."
    )
    seeds: int = option(1, limits=SEEDS, help="Number of seeds, from --seed on.")
    seed: int = option(0, limits=INDEX, help="The first seed.")
    iterations: int | None = option(
        None, limits=COUNT, help="Iterations of each training; default: that of the task, or 100."
    )
    jobs: int | None = option(None, "-j", limits=WORKERS, help="Number of parallel processes; default: one per CPU.")
    scheduler: str | None = option(None, metavar="ADDRESS", help="Address of a Dask cluster for the trainings.")
    pdf: Path | None = option(None, help="Write a PDF report to this file.")

    @classmethod
    def epilog(cls) -> str:
        """Return the help text on tasks, algorithms and settings, below the examples."""
        from reports.cli.learning.training_options import help_text

        return f"\n{help_text()}\n"


class EvaluateOptions(RunOptions, LawOptions):
    """Evaluate a trained policy: returns, lengths, measures, and violations in its episodes.

    The initial states differ from those of every training; the same seed gives the same episodes.
    """

    code: ClassVar = "reports.cli.learning.train_command:evaluate"
    examples: ClassVar = ("evaluate @last", "evaluate @last --contact barrier -c mu=1e-3 --episodes 1000")
    contact: str = option("exact", help=LAW_HELP)
    episodes: int = option(100, "-n", limits=EPISODES, help="Number of episodes.")
    seed: int = option(0, limits=INDEX, help="Seed of the initial states.")
