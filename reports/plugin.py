"""Entry points of this package (:mod:`ocp.plugins`): the command line, and output of an ``ocp.Solution``."""

from __future__ import annotations

import base64
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

from ocp import store

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ocp.solution import Solution
    from problems.spec import ProblemSpec
    from reports.drawing.view import RunView


def main() -> None:
    """Run ``ocp`` with the arguments of the process, and end the process."""
    from reports.cli.start import main

    main()


def report(solution: Solution, path: Path) -> Path:
    """Write the PDF report of a solution, stored or not, and return its path."""
    from reports.documents.pdf import write_pdf

    write_pdf([store.in_memory_run(solution)], path, file_spec=_file_spec(solution))
    return path


def animate(solution: Solution, path: Path, fps: int, speed: float) -> Path:
    """Write the animation of plan and replay at ``speed`` times real time, and return its path."""
    from reports.drawing.style import house_style
    from reports.motion.animation import Animation
    from reports.motion.movie import check_format, write_animation

    check_format(path, fps)
    with house_style():
        write_animation(Animation(_view(solution), fps, speed), path)
    return path


def plot(solution: Solution) -> Figure:
    """Return the figure of ``ocp solve --plot``: the strobe above states, inputs and forces."""
    from reports.drawing.style import house_style, show_literally
    from reports.figures.paper import solution_figure

    with house_style():
        return show_literally(solution_figure(_view(solution)))


def html(solution: Solution) -> str:
    """Return verdict, picture and numbers as an HTML fragment, with a bar in the colour of the grade."""
    from reports.drawing.strobe import strobe
    from reports.drawing.style import GRADE_COLORS, house_style, show_literally, to_svg
    from reports.figures.trajectories import trajectory_figure

    headline, *findings = solution.verdict.split("\n")
    with house_style():
        view = _view(solution)
        svg_base64 = base64.b64encode(to_svg(show_literally(strobe(view) or trajectory_figure(view)))).decode()
    name = str(solution.record["problem"])
    rows = "".join(
        f'<tr><th style="text-align:left">{escape(key)}</th><td>{escape(value)}</td></tr>'
        for key, value in _numbers(solution).items()
    )
    return (
        f'<div style="border-left:6px solid {GRADE_COLORS[solution.grade]};padding-left:0.8em">'
        f"<p><strong>{escape(headline)}</strong><br>"
        f"{'<br>'.join(map(escape, findings))}</p>"
        f'<img alt="{escape(name)}, drawn at several instants" style="background:white;'
        f'max-width:100%" src="data:image/svg+xml;base64,{svg_base64}">'
        f"<table><tbody>{rows}</tbody></table></div>"
    )


def _numbers(solution: Solution) -> dict[str, str]:
    record = solution.record
    law_parameters = record["law_parameters"].items()
    parameters = ", ".join(f"{name} = {value:g}" for name, value in law_parameters)
    return {
        "problem": f"{record['problem']}, N = {record['N']}",
        "law": f"{record['contact']}{f', {parameters}' if parameters else ''}",
        "method, policy": f"{record['method']}, {record['policy']}",
        "solver": f"{record['solver']}, {solution.iterations} iterations, {solution.build_s + solution.solve_s:.2f} s",
    }


def _view(solution: Solution) -> RunView:
    from reports.drawing.view import RunView

    return RunView.of(store.in_memory_run(solution), _file_spec(solution))


def _file_spec(solution: Solution) -> ProblemSpec | None:
    """Return the spec of the problem's file; None for a problem without a file."""
    from problems.registry import load

    source = solution.problem.origin.source
    return None if source is None else load(source)
