"""``ocp new NAME``: write the template of a problem file."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path

from ocp.errors import InputError, input_errors
from ocp.store import atomic
from problems import names
from problems.loading import check_name
from reports.cli.commands import NewOptions
from reports.cli.request import check_output_file

TEMPLATES = {
    "plain": "bumper.py",
    "scene": "past_a_post.py",
    "machine": "push_up.py",
    "world": "dropped_ball.py",
    "robot": "hop_on.py",
}
"""Mapping from kind of problem to its template, a file of ``examples`` that wheels include (pyproject.toml)."""
_TEMPLATE_FOLDERS = [Path(__file__).with_name("templates"), Path(__file__).parents[2] / "examples"]
"""Folders of the templates in a wheel and in a checkout."""


def check(options: NewOptions) -> Path:
    """Return the file to write; raises InputError for a bad name, two kinds of template, or an existing file."""
    with input_errors():
        file = Path(f"{check_name(options.problem.removesuffix('.py'))}.py")
    if file.stem in names():
        raise InputError(f"{file.stem} is a problem of the workbench; choose another name")
    kind_flags = [f"--{kind}" for kind in TEMPLATES if getattr(options, kind, None)]
    if len(kind_flags) > 1:
        raise InputError(f"{' and '.join(kind_flags)} are two kinds of file; give one of them")
    if file.exists() or file.is_symlink():
        raise InputError(f"{file} exists; choose another name, or move the file away")
    check_output_file(file, "problem file")
    if options.robot is not None:
        from problems import robots

        robots.load(options.robot, floating=options.floating, planar=options.planar, folder=options.folder)
    return file


def run(options: NewOptions, file: Path) -> int:
    """Write the template under its new name, and print how to solve it."""
    kind = next((kind for kind in TEMPLATES if getattr(options, kind, None)), "plain")
    places = (folder / TEMPLATES[kind] for folder in _TEMPLATE_FOLDERS)
    text = next(place for place in places if place.exists()).read_text(encoding="utf-8")
    problem_text = re.sub('^name = ".*"$', f'name = "{file.stem}"', text, count=1, flags=re.MULTILINE)
    if options.robot is not None:
        bases = ("floating", "planar")
        robot_arguments = _relative(options.robot)
        robot_arguments += "".join(f", {base}=True" for base in bases if getattr(options, base))
        if options.folder is not None:
            robot_arguments += f", folder=Path(__file__).parent / {_relative(options.folder)}"
        problem_text = problem_text.replace('"hopper.xml")', f"{robot_arguments})")
    atomic.write_file(file, problem_text.encode(), "the problem file")
    if kind == "world":
        options.output.say(f"world file: {file}; judge its gradient with ocp gradients {file}")
    else:
        options.output.say(f"problem file: {file}; solve it with ocp solve {file} --contact exact")
    options.output.document({"file": str(file), "problem": file.stem, "template": kind})
    return 0


def _relative(path: Path) -> str:
    """Return the path relative to the current folder, as a Python string literal."""
    place = os.path.relpath(path.expanduser().resolve(), Path.cwd())
    return json.dumps(Path(place).as_posix(), ensure_ascii=False)
