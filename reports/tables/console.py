"""Tables and progress on the terminal; every table fits 80 columns."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from typing import Any

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from ocp.judge.audit import Audit
from ocp.judge.certificate import Certificate
from ocp.judge.referee import RefereeReport
from ocp.judge.route_report import Attempt
from ocp.routes.branches import ACTIVE_SET, NEIGHBOUR
from ocp.routes.homotopy import StageRecord
from ocp.solution import Solution

TERMINAL_COLUMNS = 80
"""Width of tables [characters]."""


def print_table(table: Table | Group) -> None:
    """Print a table that is the result of a command on stdout, at most 80 columns wide."""
    Console(width=TERMINAL_COLUMNS, highlight=False, markup=False).print(table)


def number(value: float | None, digits: int = 6) -> str:
    """Return a number as text with ``digits`` significant digits; a dash for a missing or non-finite number."""
    if value is None or not math.isfinite(value):
        return "–"
    return f"{value:.{digits}g}"


def value_text(value: Any, digits: int = 6) -> str:
    """Return any value as text, a float with ``digits`` significant digits."""
    return number(value, digits) if isinstance(value, float) else str(value)


def percent(share: float | None) -> str:
    """Return a fraction in percent; a dash for a missing or non-finite value."""
    return "–" if share is None else f"{number(100 * share, 3)} %"


def small(value: float | None) -> str:
    """Return a residual as text with two digits, such as ``1.5e-07``; a dash for a missing or non-finite value."""
    return "–" if value is None or not math.isfinite(value) else f"{value:.1e}"


def table_of(*columns: str, rows: Iterable[Sequence[str]] = (), title: str | None = None, header: bool = True) -> Table:
    """Return a table with titled columns, right-aligned if the title begins with ``>``."""
    table = Table(box=None, title=title, title_justify="left", pad_edge=False, padding=(0, 2, 0, 0), show_header=header)
    for name in columns:
        head = Text(name.removeprefix(">"))  # brackets around a unit are not markup
        table.add_column(head, justify="right" if name[:1] == ">" else "left")
    for row in rows:
        table.add_row(*row)
    return table


def stage_title(label: str) -> str:
    """Return the name of the varied parameter in a heading: ``contact.mu`` becomes ``mu``."""
    return label.rpartition(".")[2] or "parameter"


def stage_table(stages: Sequence[StageRecord], cost: float | None) -> Table:
    """Return a table of homotopy stages: parameter, cost, residuals, iterations, seconds and a note."""
    labels = {stage.label for stage in stages}
    head = stage_title(labels.pop()) if len(labels) == 1 else "parameter"
    rows = (
        (index, f"{stage_title(label)} {value}".rstrip() if head == "parameter" else value, *cells)
        for index, label, value, *cells in stage_rows(stages, cost)
    )
    heads = (">stage", f">{head}", ">cost", ">lam·gap", ">residual", ">iter", ">s", "")
    return table_of(*heads, rows=rows)


def stage_rows(stages: Sequence[StageRecord], cost: float | None) -> list[tuple[str, ...]]:
    """Return a row per shown stage: number, label, value, cost, lam·gap, residual, iterations, seconds and note."""
    numbered_stages, has_answer = shown_stages(stages, cost)
    rows = [_stage_cells(index, stage) for index, stage in numbered_stages]
    return [*rows[:-1], (*rows[-1][:-1], "answer")] if has_answer else rows


def _stage_cells(index: int, stage: StageRecord) -> tuple[str, ...]:
    return (
        str(index),
        stage.label,
        small(stage.value) if stage.value else "",
        number(stage.cost, 7),
        small(stage.complementarity),
        small(stage.residual),
        str(stage.iterations),
        _seconds(stage),
        "" if stage.accepted else "stepped back",
    )


def stage_line(stage: StageRecord) -> str:
    """Return a homotopy stage as one line of at most 80 columns."""
    tail = "" if stage.accepted else "  stepped back"
    return (
        f"{stage_title(stage.label)} {small(stage.value)}  cost {number(stage.cost, 7)}"
        f"  lam·gap {small(stage.complementarity)}  {stage.iterations} it"
        f"  {_seconds(stage)} s{tail}"
    )


def _seconds(stage: StageRecord) -> str:
    return f"{stage.seconds:.2f}" if math.isfinite(stage.seconds) else "–"


class StageLines:
    """Callback that prints homotopy stages during a solve, as lines of a table of 80 columns."""

    def __init__(self) -> None:
        self.filter = StageFilter()

    def __call__(self, stage: StageRecord) -> None:
        """Print a stage, unless it is filtered out, and the headings before the first stage."""
        if not self.filter.take(stage):
            return
        if self.filter.number == 1:
            heads = ("stage", "parameter", "cost", "lam·gap", "residual", "iter", "s")
            print(_line(*heads), file=sys.stderr)
        index, label, value, *cells, note = _stage_cells(self.filter.number, stage)
        line = _line(index, f"{stage_title(label)} {value}", *cells, note.removeprefix("stepped "))
        print(line, file=sys.stderr, flush=True)


class StageFilter:
    """Filter of the stages that tables show; it omits neighbouring schedules that did not lower the cost."""

    def __init__(self) -> None:
        self.lowest, self.number = float("inf"), 0

    def take(self, stage: StageRecord) -> bool:
        """Return whether the next stage is shown; if so, increase ``number``, the count of shown stages."""
        lowers_cost = stage.accepted and stage.cost < self.lowest
        if lowers_cost and stage.label in (ACTIVE_SET, NEIGHBOUR):
            self.lowest = stage.cost
        is_shown = stage.label != NEIGHBOUR or lowers_cost
        self.number += is_shown
        return is_shown


def shown_stages(stages: Sequence[StageRecord], cost: float | None) -> tuple[list[tuple[int, StageRecord]], bool]:
    """Return the stages that tables show, with their numbers, and whether the last stage gave the solution.

    The solution is the iterate of the last accepted stage whose cost equals ``cost``. Later stages are omitted. If no
    stage has this cost, all stages are shown.
    """
    stage_filter = StageFilter()
    numbered_stages = [(stage_filter.number, stage) for stage in stages if stage_filter.take(stage)]
    cost = math.nan if cost is None else cost
    differences = [(abs(stage.cost - cost), -number) for number, stage in numbered_stages if stage.accepted]
    smallest_difference, cut_index = min(differences, default=(math.inf, 0))
    has_answer = math.isfinite(cost) and smallest_difference <= _SAME * max(abs(cost), _SAME)
    return numbered_stages[: -cut_index if has_answer else None], has_answer


_SAME = 1e-6
"""Largest relative difference between the costs of a solution and of its stage."""


def stage_note(stages: Sequence[StageRecord], cost: float | None) -> str:
    """Return sentences on the stage that gave the solution and on stages omitted in tables, "" if none apply."""
    numbered_stages, has_answer = shown_stages(stages, cost)
    n_neighbours = sum(stage.label == NEIGHBOUR for stage in stages)
    n_neighbours -= sum(stage.label == NEIGHBOUR for _, stage in numbered_stages)
    n_later = len(stages) - len(numbered_stages) - n_neighbours
    sentences = [f"Stage {numbered_stages[-1][0]} gave the answer."] if has_answer else []
    for count, noun, predicate in (
        (n_neighbours, "neighbouring contact schedule", "tried without a lower cost."),
        (n_later, "later stage", "solved without a better answer."),
    ):
        if count:
            sentences.append(f"{count} {noun}{'s were' if count > 1 else ' was'} {predicate}")
    return " ".join(sentences)


def _line(*cells: str) -> str:
    widths = (5, 18, 13, 7, 8, 5, 6, 0)
    return "  ".join(f"{cell:>{column_width}}" for cell, column_width in zip(cells, widths, strict=False)).rstrip()


@contextmanager
def live(quiet: bool, every_s: float, delay: bool = False) -> Iterator[Callable[..., None]]:
    """Yield ``show(line, now=False, picture=None)``, which reports progress on stderr.

    On a terminal the ``line``, or ``picture()``, is updated in place ten times a second at most; otherwise a line is
    printed if it is not empty, at most once per ``every_s`` seconds unless ``now`` is true. With
    ``delay`` the first report is made only after one such interval.
    """
    console = Console(stderr=True, highlight=False)
    screen = Live(console=console, transient=True, auto_refresh=False)
    terminal, last = console.is_terminal, time.monotonic() if delay else -math.inf

    def show(line: str, now: bool = False, picture: Callable[[], RenderableType] | None = None) -> None:
        nonlocal last
        seconds = time.monotonic()
        due = now or seconds - last >= (0.1 if terminal else every_s)
        if quiet or not due or not (line or terminal):
            return
        last = seconds
        if terminal:
            screen.update(picture() if picture else Text(line), refresh=True)
        else:
            print(line, file=sys.stderr, flush=True)

    with screen if terminal and not quiet else nullcontext():
        yield show


@contextmanager
def progress(visible: bool, first: str) -> Iterator[Callable[[StageRecord], None]]:
    """Yield a callback that reports homotopy stages: a live line on a terminal, otherwise lines of a table."""
    if not visible or not sys.stderr.isatty():
        yield StageLines() if visible else lambda _: None
        return
    with live(False, 0.0) as show:
        show(first)
        yield lambda stage: show(stage_line(stage), now=True)


def result_table(solution: Solution) -> Table:
    """Return a table of a solve's costs, audited residuals, iterations and times."""
    audit, iteration_s = solution.audit, solution.iteration_s
    per_iteration_ms = ", ".join(number(1e3 * iteration_s[key], 3) for key in ("evaluation", "solver"))
    total_s = f"{number(solution.evaluation_s, 3)}, {number(solution.solver_s, 3)}"
    rows = [
        ("cost under the chosen law", number(solution.cost, 8), ""),
        ("cost under the exact law", number(audit.exact_cost, 8), "the plan replayed"),
        *judged_rows(solution.certificate, solution.referee),
        ("complementarity", small(audit.complementarity), "max lam·gap"),
        ("", small(audit.complementarity_min), "max min(lam, gap)"),
        ("dynamics residual", small(audit.dynamics_residual), ""),
        ("penetration", small(audit.penetration), "m, by true signed distance"),
        *distance_rows(solution.referee),
        ("state error of the replay", small(audit.state_gap), "max |x - x_replay|"),
        ("iterations", str(solution.iterations), solution.route.name and f"by the route {solution.route.name}"),
        ("build, solve", f"{solution.build_s:.2f}, {solution.solve_s:.2f}", "s"),
        ("time in functions, solver", total_s, f"s; {per_iteration_ms} ms per iteration"),
    ]
    rows[-3:-3] = [(name, small(value), explanation) for name, value, explanation in physics_residuals(audit)]
    return table_of("", ">", "", rows=rows, header=False)


def judged_rows(certificate: Certificate, referee: RefereeReport) -> list[tuple[str, str, str]]:
    """Return rows (name, number, explanation) on the referee's replay and the stationarity certificate."""
    rows = [("", "no referee", "the system has no geometry")]
    if referee.survives is not None:
        rows = [
            ("cost under the referee", number(referee.cost, 8), referee.note),
            ("state error of the referee", small(referee.gap), ""),
        ]
    if math.isfinite(referee.refined_cost):
        rows.append(("referee cost at h/4", number(referee.refined_cost, 8), referee.word))
    kind = f", {certificate.kind}" if certificate.kind else ""
    biactive = f"{certificate.biactive} pairs biactive" if certificate.kind else ""
    rows += [
        ("stationarity", f"{certificate.stationarity}{kind}", biactive),
        ("KKT residual", small(certificate.kkt_residual), ""),
    ]
    if certificate.negative_curvature > 0:
        rows.append(("negative curvature", str(certificate.negative_curvature), "directions"))
    return rows


def distance_rows(referee: RefereeReport) -> list[tuple[str, str, str]]:
    """Return rows (name, value, location) on the deepest penetration between nodes and the largest gap with a force."""
    named_distances = (
        ("penetration between nodes", referee.between),
        ("distance where force acts", referee.force_distance),
    )
    return [
        (name, small(worst.amount), f"m, {worst.contact}, step {worst.step}" if worst.amount > 0 else "m")
        for name, worst in named_distances
        if worst is not None
    ]


def physics_residuals(audit: Audit) -> list[tuple[str, float, str]]:
    """Return rows (name, residual, unit) of the finite residuals of friction, energy and momentum."""
    residuals = (
        ("friction cone violated by", audit.cone_violation, "N s"),
        ("dissipation below maximum", audit.dissipation_residual, "J"),
        ("energy gained in a step", audit.energy_gain, "J, contact and integrator"),
        ("momentum residual", audit.momentum_residual, "N s"),
    )
    return [row for row in residuals if math.isfinite(row[1])]


def violation_table(solution: Solution) -> Table:
    """Return a table of the most violated constraints of a failed solve."""
    heads = ("worst constraint", "component", ">scenario", ">step", ">violation")
    return table_of(*heads, rows=violation_rows(solution.audit))


def violation_rows(audit: Audit) -> list[tuple[str, ...]]:
    """Return constraint, component, scenario, step and amount of the worst violations as text."""
    return [(v.name, v.component, str(v.scenario), str(v.step), small(v.amount)) for v in audit.worst]


def starts_table(attempts: Sequence[Attempt]) -> Table:
    """Return a table of all solutions that a solve compared, one row per solution."""
    columns = ("start", "route", "status", "cost", "exact_cost", "referee_cost", "iterations")
    values = ([getattr(attempt, name) for name in columns] for attempt in attempts)
    rows = ([number(v, 8) if isinstance(v, float) else str(v) for v in row] for row in values)
    heads = (f">{name.replace('_', ' ')}" for name in columns)
    return table_of(*heads, rows=rows, title="tried")
