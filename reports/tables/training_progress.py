"""Progress of training runs on the terminal: a line and a curve per run; for a single run also the last rows."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from rich.console import Group, RenderableType

from reports.tables import console
from reports.tables.console import number, small, table_of

Callback = Callable[[int, Mapping[str, float]], None]
_LAST_ROWS = 5
"""Number of last rows shown for a single training run."""
_ROW_COLUMNS = 6
"""Number of columns in the table of last rows, after the iteration."""
_PLOT_SIZE = (56, 6)
"""Width and height of the curve of a single training run [characters]."""
_SPARKLINE_WIDTH = 20
"""Width of a run's curve if several training runs are shown [characters]."""
_ELSEWHERE = (
    "iteration",
    "wall_s",
    "env_steps",
    "evaluation_return_deviation",
    "evaluation_length",
    "evaluation_unsolved",
)
"""Quantities that are not in the table of last rows."""


@dataclass
class LearningCurve:
    """Rows reported so far by a training run of ``iterations`` iterations."""

    name: str
    iterations: int
    rows: list[Mapping[str, float]] = field(default_factory=list)

    def values(self, name: str) -> list[float]:
        """Return the values of the quantity ``name`` in all rows that have it."""
        return [row[name] for row in self.rows if name in row]

    def last(self, name: str) -> float | None:
        """Return the last value of the quantity ``name``, or None before the first value."""
        return next(reversed(self.values(name)), None)

    @property
    def curve(self) -> list[float]:
        """Returns under the exact law; if there are fewer than two, mean returns of the training samples."""
        exact, sampled = self.values("evaluation_return"), self.values("return_mean")
        return exact if len(exact) > 1 or not sampled else sampled

    @property
    def left(self) -> float | None:
        """Estimated time to the last iteration [s], from the rate since the first row; None if unknown."""
        first, last = self.rows[0], self.rows[-1]
        done = last["iteration"] - first["iteration"]
        if not done or "wall_s" not in last:
            return None
        return (last["wall_s"] - first["wall_s"]) / done * (self.iterations - last["iteration"])


@contextmanager
def show_trainings(trainings: Mapping[str, int], quiet: bool, check: Callable[[], None]) -> Iterator[Callback]:
    """Yield a callback whose arguments are the index of a training run and its next row.

    ``trainings`` maps names of runs to their numbers of iterations. On a terminal all runs are shown; otherwise
    a line is printed per evaluation, at most every ten seconds. Each call of the callback calls ``check``.
    """
    curves = [LearningCurve(name, iterations) for name, iterations in trainings.items()]
    with console.live(quiet, every_s=10.0) as show:

        def callback(index: int, row: Mapping[str, float]) -> None:
            check()
            training = curves[index]
            training.rows.append(row)
            line_text, is_last = training_line(training), row["iteration"] >= training.iterations
            show(line_text if "evaluation_return" in row else "", is_last, lambda: progress_view(curves))

        yield callback


def training_line(training: LearningCurve) -> str:
    """Return the state of a training run as one line of at most 80 columns."""
    row = training.rows[-1]
    cells = [f"{training.name}  {row['iteration']:.0f}/{training.iterations}"]
    values = ((title, training.last(key), show) for key, title, show in _LINE_VALUES)
    cells += [f"{title} {show(value)}" for title, value, show in values if value is not None]
    return "  ".join([*cells, f"{row.get('wall_s', 0.0):.0f} s"])


_LINE_VALUES: tuple[tuple[str, str, Callable[[float], str]], ...] = (
    ("evaluation_return", "exact", lambda value: number(value, 4)),
    ("return_mean", "return", lambda value: number(value, 4)),
    ("gradient_norm", "|gradient|", small),
)
"""Key, title and formatting function of each value in the line of a training run."""


def progress_view(curves: Sequence[LearningCurve]) -> RenderableType:
    """Return a table of training runs; for a single run also its curve and its last rows."""
    heads = ("training", ">iteration", ">exact return", ">return", ">time", ">left", "")
    table = table_of(*heads, rows=[_cells(training) for training in curves])
    if len(curves) > 1 or not curves[0].rows:
        return table
    training = curves[0]
    plot_text = "\n".join(bar_plot(training.curve, *_PLOT_SIZE)) if len(training.curve) > 1 else ""
    return Group(table, "", plot_text, "", rows_table(training.rows[-_LAST_ROWS:]))


def _cells(training: LearningCurve) -> tuple[str, ...]:
    if not training.rows:
        return (training.name, f"–/{training.iterations}", "", "", "", "", "")
    row, seconds_left = training.rows[-1], training.left
    return (
        training.name,
        f"{row['iteration']:.0f}/{training.iterations}",
        number(training.last("evaluation_return"), 4),
        number(training.last("return_mean"), 4),
        f"{row.get('wall_s', 0.0):.0f} s",
        "" if seconds_left is None else f"{seconds_left:.0f} s",
        sparkline(training.curve, _SPARKLINE_WIDTH),
    )


def rows_table(rows: Sequence[Mapping[str, Any]]) -> RenderableType:
    """Return a table of a training run's rows: columns of evaluations first, then others."""
    names = list(dict.fromkeys(name for row in rows for name in row if name not in _ELSEWHERE))
    names.sort(key=lambda name: not name.startswith("evaluation_"))
    names = names[:_ROW_COLUMNS]
    titles = [name.replace("evaluation_", "exact ").replace("_", " ") for name in names]
    cells = ([f"{row['iteration']:.0f}", *(number(row.get(name), 4) for name in names)] for row in rows)
    return table_of(">iteration", *(f">{title}" for title in titles), rows=cells)


_EIGHTHS = " ▁▂▃▄▅▆▇█"
"""Block characters that fill zero to eight eighths of a line's height."""


def sparkline(values: Sequence[float], width: int) -> str:
    """Return up to ``width`` characters from ▁, the smallest value, to █, the largest; spaces for NaN."""
    return _bars(values, width, 1)[0][0]


def bar_plot(values: Sequence[float], width: int, height: int) -> list[str]:
    """Return the lines of a bar chart, with the largest and the smallest value at the left."""
    rows, low, high = _bars(values, width, height)
    ends = [f"{high:.4g}", *[""] * (height - 2), f"{low:.4g}"]
    margin = max(map(len, ends))
    return [f"{end:>{margin}} ┤{row.rstrip()}" for end, row in zip(ends, rows, strict=True)]


def _bars(values: Sequence[float], width: int, height: int) -> tuple[list[str], float, float]:
    """Return rows of a bar chart, and the smallest and largest value; more than ``width`` values are thinned out."""
    numbers = np.asarray(values, dtype=float)
    if len(numbers) > width:
        numbers = numbers[np.linspace(0, len(numbers) - 1, width).round().astype(int)]
    finite = numbers[np.isfinite(numbers)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 0.0)
    heights = (numbers - low) / (high - low) if high > low else 0.5 + 0.0 * numbers
    eighths = [1 + round((8 * height - 1) * h) if np.isfinite(h) else 0 for h in heights.tolist()]
    rows = ["".join(_EIGHTHS[min(8, max(0, count - 8 * row))] for count in eighths) for row in reversed(range(height))]
    return rows, low, high
