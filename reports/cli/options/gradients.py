"""Options of ``ocp gradients``."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

from dynamics.limits import INDEX
from reports.cli.options.shared import JobsOptions, SourceOptions, TagOptions, argument, assignment, option


class GradientsOptions(JobsOptions, TagOptions, SourceOptions):
    """Judge whether a simulator's gradient through contact is right, and say what to use instead.

    A world is a simulator: exact, barrier, adaptive, randomized, penalty, mujoco, mjx, mjx-reverse, closed-form, or
    path/to/file.py.
    Its derivative, its secants over many amplitudes and its smoothed gradients are compared with the exact slope. This
    is the derivative of the rigid limit, which every scene of ocp list has in closed form; a file may define
    truth(theta) or slope; for a plan it is the derivative of its cost by its inputs under the exact law. Finished
    worlds are kept: after Ctrl-C the same command resumes.
    """

    code: ClassVar = "reports.cli.gradients.command"
    examples: ClassVar = (
        "gradients oblique-drop --world exact --world mujoco -j 2 --pdf drop.pdf",
        "gradients two-balls --world penalty -s stiffness=1e5",
        "gradients my_simulator.py",
        "gradients stick-slip --world my_simulator.py",
        "gradients @last --world mujoco",
    )
    scene: str = argument(
        metavar="SCENE|FILE|RUN", help="A scene, a file that defines rollout(theta) and theta, or a solve: @last."
    )
    worlds: list[str] | None = option(
        None, "--world", metavar="WORLD", help="A simulator, or a file that defines rollout(theta); may be repeated."
    )
    settings: list[str] | None = assignment(
        "--setting", "-s", help="Setting of the simulators that have it, such as h, stiffness, mu."
    )
    parameter: int = option(0, limits=INDEX, help="Index of the parameter of a file.")
    component: int = option(0, limits=INDEX, help="Index of the output of a file.")
    samples: str = option("2000", "-n", help="Samples of each smoothed gradient; 200 by default of a plan.")
    tolerance: float = option(0.05, help="Largest error of a right slope, as a share of the exact slope.")
    refinements: int = option(2, help="Number of times that each simulator is refined, at most 6.")
    seed: int = option(0, help="Random seed.")
    pdf: Path | None = option(None, help="Write a PDF report to this file.")
