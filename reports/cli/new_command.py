"""``ocp new NAME``: write the template of a problem file."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path

from ocp.errors import InputError, did_you_mean, input_errors
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
TASKS = {
    "stand": "stand_up.py",
    "reach": "reach_out.py",
    "walk": "walk_on.py",
    "jump": "jump_up.py",
    "push": "push_on.py",
}
"""Mapping from a robot's task to its template, like :data:`TEMPLATES`."""
_ROBOT_FILE = re.compile(r'(?<=Path\(__file__\)\.parent / )"[^"]*"(?=\))')
"""Name of the robot's file in a template."""
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
    _check_task(options)
    return file


def _check_task(options: NewOptions) -> None:
    """Read the robot's file; raises InputError if it cannot be read, or if its task makes no sense."""
    task = options.task
    if task is not None and options.robot is None:
        raise InputError("--task is for a robot; give its file with --robot")
    if task is not None and task not in TASKS:
        raise InputError(f"unknown task {task!r}{did_you_mean(task, TASKS)}; expected {', '.join(TASKS)}")
    if options.robot is not None:
        from problems import robots

        robot = robots.load(options.robot, floating=options.floating, planar=options.planar, folder=options.folder)
        if task is not None:
            from problems.robots.poses import check_task

            check_task(robot, task)


def run(options: NewOptions, file: Path) -> int:
    """Write the template under its new name, and print how to solve it."""
    kind = next((kind for kind in TEMPLATES if getattr(options, kind, None)), "plain")
    template = TEMPLATES[kind] if options.task is None else TASKS[options.task]
    candidates = (folder / template for folder in _TEMPLATE_FOLDERS)
    text = next(candidate for candidate in candidates if candidate.exists()).read_text(encoding="utf-8")
    problem_text = re.sub('^name = ".*"$', f'name = "{file.stem}"', text, count=1, flags=re.MULTILINE)
    if options.robot is not None:
        bases = ("floating", "planar")
        robot_arguments = _relative(options.robot)
        robot_arguments += "".join(f", {base}=True" for base in bases if getattr(options, base))
        if options.folder is not None:
            robot_arguments += f", folder=Path(__file__).parent / {_relative(options.folder)}"
        problem_text = _ROBOT_FILE.sub(lambda _: robot_arguments, problem_text, count=1)
    atomic.write_file(file, problem_text.encode(), "the problem file")
    if kind == "world":
        options.output.say(f"simulator file: {file}; judge its gradient with ocp gradients {file}")
    else:
        options.output.say(f"problem file: {file}; solve it with ocp solve {file} --contact exact")
    options.output.document({"file": str(file), "problem": file.stem, "template": kind, "task": options.task})
    return 0


def _relative(path: Path) -> str:
    """Return the path relative to the current folder, as a Python string literal."""
    relative_path = os.path.relpath(path.expanduser().resolve(), Path.cwd())
    return json.dumps(Path(relative_path).as_posix(), ensure_ascii=False)
