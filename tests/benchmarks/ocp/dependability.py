"""Exact-law solves of every named problem from 21 guesses, and the README's table of them.

``make bench-solve`` runs it; ``PROBLEMS="hopper push-1d"`` asks for some of them, and rewrites
their rows alone.
"""

from __future__ import annotations

import math
import re
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from statistics import median

from dynamics.contact import Exact
from ocp.judgement import judged
from ocp.solution import Solution
from ocp.solve import guesses, new_session
from problems import get, names, spec

README = Path(__file__).parents[3] / "README.md"
BEGIN, END = "<!-- made by make bench-solve -->", "<!-- end of make bench-solve -->"
COLUMNS = (
    "problem", "N", "pairs a step", "solved of 20", "default guess", "median iterations",
    "median s", "best cost", "worst cost", "within 1 % of the best", "floor",
)  # fmt: skip
PERTURBED, SEED, WORKERS = 20, 0, 2
FLOORS = {
    "push-1d": 19, "push-disc": 19, "planar-push": 19, "planar-hand": 19,
    "hopper": 16, "half-cheetah": 16,
}  # fmt: skip


@dataclass(frozen=True)
class Start:
    """What came of one guess; number 0 is the problem's own. ``seconds`` of processor time."""

    problem: str
    index: int
    steps: int
    pairs: int
    success: bool
    status: str
    cost: float
    iterations: int
    seconds: float
    where: str


def from_guess(problem: str, index: int) -> Start:
    """Solve from one guess, everything built afresh, so that no other solve can matter."""
    session = new_session(get(problem), Exact())
    guess = guesses(session, PERTURBED + 1, SEED)[index]
    began = time.process_time()
    outcome = session.solve(guess=guess)
    seconds = time.process_time() - began
    found = judged(session, outcome, SEED)
    made = session.problem
    return Start(
        problem, index, made.N, made.system.nlam, found.success, found.status.label, found.cost,
        found.iterations, seconds, _where(found),
    )  # fmt: skip


def _where(found: Solution) -> str:
    """Say at which stage a solve ended, with what word, and which constraint is off most."""
    last = found.stages[-1]
    text = f"stage {len(found.stages)}, {last.knob} {last.value:.1e}: {last.status}"
    for off in found.audit.worst[:1]:
        text += f"; {off.name} {off.component} at step {off.step} off by {off.amount:.1e}"
    return text


def row(starts: Sequence[Start]) -> list[str]:
    """The table's row of one problem; medians over all starts, failed ones too."""
    good = sorted(start.cost for start in starts if start.success)
    best, worst = (good[0], good[-1]) if good else (math.nan, math.nan)
    close = sum(cost <= best + 0.01 * abs(best) for cost in good)
    own, floor = starts[0], FLOORS.get(starts[0].problem)
    return [
        f"`{own.problem}`", str(own.steps), str(own.pairs), str(solved(starts)),
        "solved" if own.success else own.status,
        f"{median(start.iterations for start in starts):.0f}",
        f"{median(start.seconds for start in starts):.2g}",
        f"{best:.6g}", f"{worst:.6g}", f"{close} of {len(starts)}", str(floor or ""),
    ]  # fmt: skip


def solved(starts: Sequence[Start]) -> int:
    """How many of the perturbed starts the audit accepts."""
    return sum(start.success for start in starts if start.index > 0)


def table(rows: Sequence[Sequence[str]]) -> str:
    """A markdown table, the first column to the left."""
    head = [COLUMNS, ["---", *["---:"] * (len(COLUMNS) - 1)], *rows]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in head) + "\n"


def rewritten(text: str, fresh: Sequence[Sequence[str]]) -> str:
    """Put rows between the markers of ``text``: fresh ones replace, the others stay."""
    before, found = text.split(BEGIN)
    old, after = found.split(END)
    rows = {}
    for line in re.findall(r"^\| (`.*) \|$", old, re.MULTILINE):
        cells = line.split(" | ")
        rows[cells[0]] = cells
    rows |= {cells[0]: list(cells) for cells in fresh}
    order = [f"`{name}`" for name in names()]
    kept = [rows[name] for name in order if name in rows]
    return f"{before}{BEGIN}\n{table(kept)}{END}{after}"


def measured(chosen: Sequence[str]) -> Iterator[list[Start]]:
    """All starts of one problem after the other; two processes, which share nothing."""
    with ProcessPoolExecutor(WORKERS, mp_context=get_context("spawn")) as pool:
        indices = range(PERTURBED + 1)
        pending = [pool.map(from_guess, [name] * len(indices), indices) for name in chosen]
        for results in pending:
            yield list(results)


def main() -> int:
    """Measure, print failures as they come, rewrite the README; 1 where a floor is missed."""
    chosen = [spec(name).name for name in sys.argv[1:]] or names()
    rows, missed = [], []
    for starts in measured(chosen):
        rows.append(row(starts))
        name = starts[0].problem
        print(f"{name}: {solved(starts)} of {PERTURBED}", file=sys.stderr, flush=True)
        for start in starts:
            if not start.success:
                print(f"  start {start.index}: {start.status}; {start.where}", file=sys.stderr)
        if solved(starts) < FLOORS.get(name, 0):
            missed.append(f"{name}: {solved(starts)} of {PERTURBED}, floor {FLOORS[name]}")
        README.write_text(rewritten(README.read_text(), rows))
    print(table(rows))
    print("below the floor: " + "; ".join(missed) if missed else "every floor is met")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
