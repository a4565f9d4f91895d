"""Draw the README's pictures from stored runs.

``python -m docs.generator.readme_pictures ROOT FOLDER --still NAME... --moving NAME...`` draws
the problems after ``--still`` in one ``strobes.png``, and each one after ``--moving`` as ``<name>.gif``.
"""

from __future__ import annotations

import sys
from argparse import ArgumentParser
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from ocp.errors import InputError
from ocp.store import atomic
from ocp.store.runs import load, run_paths
from reports.drawing.strobe import draw_strobe
from reports.drawing.style import house_style
from reports.drawing.view import RunView
from reports.motion.animation import Animation, is_periodic, repeated
from reports.motion.movie import write_animation

_COLUMNS = 3
"""Number of strobe pictures in a row."""
_WIDTH = 10.5
"""Width of the picture of strobes [inch]."""
_STRIDES = 4
"""Number of strides of a periodic motion in an animation."""
LARGEST = 1_500_000
"""Maximum size of an animation on a page [bytes]."""


def picture(views: Sequence[RunView]) -> Figure:
    """Return a figure of strobe pictures in rows of three, each under the title of its problem."""
    columns = min(_COLUMNS, len(views))
    rows = -(-len(views) // columns)
    figure = Figure(layout="constrained")
    grid = figure.add_gridspec(rows, columns)
    heights = np.zeros(rows)
    for index, view in enumerate(views):
        row, column = divmod(index, columns)
        axis = figure.add_subplot(grid[row, column])
        draw_strobe(axis, view)
        axis.set_title("", loc="left")
        axis.set_title(view.title, fontsize=10)
        ratio = np.clip(np.ptp(axis.get_ylim()) / np.ptp(axis.get_xlim()), 0.2, 1.1)
        heights[row] = max(heights[row], 0.9 + (_WIDTH / columns - 0.7) * float(ratio))
    grid.set_height_ratios(heights)
    figure.set_size_inches(_WIDTH, float(heights.sum()))
    return figure


def newest(root: Path, name: str) -> RunView:
    """Return the latest run of a problem below ``root``.

    Raises :class:`~ocp.errors.InputError` if there is none.
    """
    paths = [path for path in run_paths(root) if path.parent.name == name]
    if not paths:
        raise InputError(f"{root} has no run of {name}; ocp solve {name} --out {root} stores one")
    return RunView.of(load(paths[-1]))


def moving(view: RunView) -> Animation:
    """Return the animation of a run; a periodic one is repeated for several strides, at half speed."""
    return Animation(repeated(view, _STRIDES), speed=0.5) if is_periodic(view) else Animation(view)


def draw(root: Path, folder: Path, still: Sequence[str], moved: Sequence[str]) -> list[Path]:
    """Draw the latest run of every problem, and return the files, the strobes first.

    Raises :class:`~ocp.errors.InputError` for a problem without a run, and for an animation that
    is too large.
    """
    files = [folder / "strobes.png", *(folder / f"{name}.gif" for name in moved)]
    with house_style():
        strobes = picture([newest(root, name) for name in still])
        with atomic.replace_file(files[0]) as draft:
            strobes.savefig(draft, dpi=110, metadata={"Software": None})
        for name, file in zip(moved, files[1:], strict=True):
            write_animation(moving(newest(root, name)), file)
            if file.stat().st_size > LARGEST:
                raise InputError(
                    f"{file} has {file.stat().st_size / 1e6:.1f} MB, at most"
                    f" {LARGEST / 1e6:g} are allowed; solve the problem with fewer steps"
                )
    return files


def main() -> None:
    """Draw the runs that the command line names, and print the size of every file."""
    parser = ArgumentParser(prog="python -m docs.generator.readme_pictures", description=__doc__)
    parser.add_argument("root", type=Path, metavar="ROOT")
    parser.add_argument("folder", type=Path, metavar="FOLDER")
    parser.add_argument("--still", nargs="+", required=True, metavar="NAME")
    parser.add_argument("--moving", nargs="*", default=[], metavar="NAME")
    arguments = parser.parse_args()
    try:
        for file in draw(arguments.root, arguments.folder, arguments.still, arguments.moving):
            print(f"{file}  {file.stat().st_size / 1e3:.0f} kB")
    except InputError as error:
        sys.exit(f"error: {error}")


if __name__ == "__main__":
    main()
