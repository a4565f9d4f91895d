"""Draw the README's pictures from stored runs: ``python -m reports.gallery ROOT FOLDER NAME...``.

``strobes.png`` has every named problem, ``<name>.gif`` each in motion.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure

from ocp.errors import InputError
from ocp.studies.store import list_runs, load
from reports.animation import Animation
from reports.movie import write
from reports.strobe import draw_strobe
from reports.style import styled
from reports.view import RunView

_COLUMNS = 3
LARGEST = 1_500_000
"""Bytes that a page can carry for one animation."""


def picture(views: Sequence[RunView]) -> Figure:
    """Strobes in rows of three, each under the title of its problem."""
    rows = -(-len(views) // _COLUMNS)
    figure = Figure(figsize=(10.5, 3.0 * rows), layout="constrained")
    axes = figure.subplots(rows, min(_COLUMNS, len(views)), squeeze=False).ravel()
    for axis, view in zip(axes, views, strict=False):
        draw_strobe(axis, view)
        axis.set_title("", loc="left")
        axis.set_title(view.title, fontsize=10)
    for axis in axes[len(views) :]:
        axis.set_axis_off()
    return figure


def newest(root: Path, name: str) -> RunView:
    """Look at the latest run of a problem below ``root``.

    Raises :class:`~ocp.errors.InputError` where there is none.
    """
    found = [entry.path for entry in list_runs(root) if entry.path.parent.name == name]
    if not found:
        raise InputError(f"{root} holds no run of {name}; ocp solve {name} --out {root} makes one")
    return RunView.of(load(found[-1]))


def draw(root: Path, folder: Path, names: Sequence[str]) -> list[Path]:
    """Draw the newest run of every problem and return the files, the strobes first.

    Raises :class:`~ocp.errors.InputError` for a problem without a run and for an animation that
    came out too large.
    """
    files = [folder / "strobes.png", *(folder / f"{name}.gif" for name in names)]
    views = [newest(root, name) for name in names]
    with styled():
        picture(views).savefig(files[0], dpi=110, metadata={"Software": None})
        for view, file in zip(views, files[1:], strict=True):
            write(Animation(view), file)
            if file.stat().st_size > LARGEST:
                raise InputError(
                    f"{file} has {file.stat().st_size / 1e6:.1f} MB, expected at most"
                    f" {LARGEST / 1e6:g}; give the problem fewer steps in the gallery"
                )
    return files


def main() -> None:
    """Draw what the command line names, and tell the size of every file."""
    root, folder, *names = sys.argv[1:]
    try:
        for file in draw(Path(root), Path(folder), names):
            print(f"{file}  {file.stat().st_size / 1e3:.0f} kB")
    except InputError as error:
        sys.exit(f"error: {error}")


if __name__ == "__main__":
    main()
