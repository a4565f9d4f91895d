"""Draw the picture of ``docs/howto/guesses.md``: a plan without a guess, and one from a drawn path.

``python -m docs.generator.guess_picture`` solves both and draws ``docs/pictures/guesses.png``.
"""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

from matplotlib.figure import Figure

from docs.generator.measured import save_picture
from ocp import Sketch, save, solve
from ocp.store.runs import load
from reports.drawing.strobe import draw_strobe
from reports.drawing.style import house_style
from reports.drawing.view import RunView

PATH = {"x": [0.0, 1.1, 2.2], "y": [0.0, 1.0, 2.0]}
"""Path [m] of the box's centre, the same as ``path.toml`` on the page."""


def picture(store: Path) -> Figure:
    """Return a figure of both plans side by side, with the drawn path dashed; runs are saved to ``store``."""
    figure = Figure(figsize=(9.0, 4.2), layout="constrained")
    guesses = {"without a guess": None, "from a drawn path": Sketch(paths=PATH)}
    for axis, (name, guess) in zip(figure.subplots(1, 2, sharex=True, sharey=True), guesses.items(), strict=True):
        solution = solve("push-box", "exact", effort="quick", guess=guess)
        draw_strobe(axis, RunView.of(load(save(solution, store))))
        axis.set_title("", loc="left")
        axis.set_title(f"{name}: cost {solution.cost:.4g}", fontsize=10)
        if guess is not None:
            axis.plot(PATH["x"], PATH["y"], "--o", color="black", markersize=4, zorder=9)
    return figure


if __name__ == "__main__":
    with house_style(), TemporaryDirectory() as store:
        save_picture(picture(Path(store)), "guesses")
