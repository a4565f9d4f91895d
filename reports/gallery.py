"""Draw the README's picture from stored runs: ``python -m reports.gallery ROOT PICTURE``."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from ocp.studies.store import list_runs, load
from reports.strobe import draw_strobe
from reports.style import styled
from reports.view import RunView


def picture(views: list[RunView]) -> Figure:
    """Strobes side by side, each under the title of its problem."""
    figure = Figure(figsize=(10.5, 3.2), layout="constrained")
    for axis, view in zip(np.atleast_1d(figure.subplots(1, len(views))), views, strict=True):
        draw_strobe(axis, view)
        axis.set_title("", loc="left")
        axis.set_title(view.title, fontsize=10)
    return figure


def main() -> None:
    """Draw the newest run of every problem below ROOT into PICTURE."""
    root, target = Path(sys.argv[1]), Path(sys.argv[2])
    newest = {entry.path.parent.name: entry.path for entry in list_runs(root)}
    with styled():
        figure = picture([RunView.of(load(path)) for path in newest.values()])
        figure.savefig(target, dpi=110, metadata={"Software": None})


if __name__ == "__main__":
    main()
