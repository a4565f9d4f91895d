"""Whether a file can be written, asked before the work that would be lost."""

from __future__ import annotations

from pathlib import Path

from ocp.errors import InputError

EXAMPLES = {
    "PDF": "report.pdf",
    "C file": "rollout.c",
    "data": "data.nc",
    "model": "model.nc",
    "figure": "figure.pdf",
}


def check_places(out: Path, pdf: Path | None) -> None:
    """Raise InputError where runs could not be stored in ``out`` or a report written to ``pdf``."""
    from ocp import store

    store.check_writable(out)
    if pdf is not None:
        check_place(pdf, "PDF")


def check_place(file: Path, what: str) -> None:
    """Raise InputError where ``file``, a PDF say, could not be written."""
    from ocp import store
    from ocp.store import atomic

    if file.is_dir():
        example = EXAMPLES.get(what, "report.gif")
        raise InputError(f"{file} is a directory; name a file such as {file / example}")
    with atomic.told(f"the {what} to {file}"):
        place = atomic.destination(file)
    if place is None:
        return
    try:
        store.check_writable(place.parent)
    except InputError as error:
        message = str(error).replace("the run", f"the {what}").replace("with --out", "for it")
        raise InputError(message) from error
