"""Files that a bare figure can be, told before anything that draws is loaded."""

from __future__ import annotations

from pathlib import Path

from ocp.errors import InputError

FORMATS = {ending: f"a .{ending} file" for ending in ("pdf", "svg", "png")}


def format_of(file: Path) -> str:
    """Return the format that a file's ending names; raises InputError for an unknown one."""
    ending = file.suffix.removeprefix(".")
    if ending not in FORMATS:
        raise InputError(
            f"a figure ends in .pdf, .svg or .png, not in {file.suffix!r}; name it"
            f" {file.with_suffix('.pdf').name}, say"
        )
    return ending
