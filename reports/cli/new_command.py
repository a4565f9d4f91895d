"""``ocp new NAME``: a problem file to begin with."""

from __future__ import annotations

from pathlib import Path

from ocp.errors import InputError, input_errors
from ocp.store import atomic
from problems import names
from problems.loading import check_name
from problems.templates import template
from reports.cli.commands import NewOptions
from reports.cli.request import check_place


def check(options: NewOptions) -> Path:
    """The file to write; raises InputError for a bad name, two kinds, or a file that exists."""
    with input_errors():
        file = Path(f"{check_name(options.problem.removesuffix('.py'))}.py")
    if file.stem in names():
        raise InputError(f"{file.stem} is a problem of the workbench; choose another name")
    if options.machine and options.scene:
        raise InputError("--machine and --scene are two kinds of file; give one of them")
    if file.exists() or file.is_symlink():
        raise InputError(f"{file} exists; choose another name, or move the file away")
    check_place(file, "problem file")
    return file


def run(options: NewOptions, file: Path) -> int:
    """Write the template under its new name, and say how to solve it."""
    kind = "machine" if options.machine else "scene" if options.scene else "plain"
    atomic.write(file, template(kind, file.stem).encode(), "the problem file")
    options.output.say(f"problem file: {file}; solve it with ocp solve {file} --contact exact")
    options.output.document({"file": str(file), "problem": file.stem, "template": kind})
    return 0
