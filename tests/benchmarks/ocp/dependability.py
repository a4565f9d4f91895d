"""Exact-law solves of every problem from 21 guesses, and the site's table of them.

Problems are the named ones and three of ``examples/`` that a reader would try. ``make bench-solve``
runs it; ``PROBLEMS="hopper push-1d behind"`` selects some of them, and rewrites their rows alone.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from statistics import median

from docs.generator.measured import DATA, read, write_table
from dynamics.contact import Exact
from ocp.problem.rollout import initial_guesses
from ocp.programs.solver import Status
from ocp.solution import Solution
from ocp.solve.judging import judge_outcome
from ocp.solve.solve import new_session
from problems import get, names, spec

TABLE = "dependability"
COLUMNS = (
    "problem",
    "N",
    "pairs a step",
    "audited of 20",
    "certified of 20",
    "default guess",
    "median iterations",
    "median s",
    "certificate s",
    "best cost",
    "worst cost",
    "within 1 % of the best",
    "referee",
    "survives",
    "floor",
)
PERTURBED, SEED, WORKERS = 20, 0, 2
FEASIBLE = {Status.SOLVED, Status.NOT_OPTIMAL, Status.UNDECIDED, Status.NO_PROGRESS}
FLOORS = {
    "push-1d": 19,
    "push-disc": 19,
    "planar-push": 19,
    "planar-hand": 19,
    "hopper": 16,
    "half-cheetah": 16,
}
EXAMPLES = Path(__file__).parents[3] / "examples"
FILES = {name: str(EXAMPLES / f"{name.replace('-', '_')}.py") for name in ("behind", "slope", "double-pendulum-walls")}
"""Files of the examples by name."""


@dataclass(frozen=True)
class Start:
    """Result from one guess; number 0 is the problem's own. ``seconds`` are of processor time.

    ``audited`` is feasible by the audit, ``success`` certified too; ``referee`` is the cost under the
    referee, NaN if there is none.
    """

    problem: str
    index: int
    steps: int
    pairs: int
    audited: bool
    success: bool
    status: str
    cost: float
    iterations: int
    seconds: float
    certificate_s: float
    referee: float
    survives: bool | None
    where: str


def from_guess(problem: str, index: int) -> Start:
    """Solve from one guess, with everything built anew, so that solves are independent."""
    session = new_session(get(FILES.get(problem, problem)), Exact())
    guess = initial_guesses(session.evaluation, PERTURBED + 1, SEED)[index]
    began = time.process_time()
    outcome = session.solve(guess=guess)
    seconds = time.process_time() - began
    found = judge_outcome(session, outcome, SEED)
    made = session.problem
    return Start(
        problem,
        index,
        made.N,
        made.system.nlam,
        found.status in FEASIBLE,
        found.success,
        found.status.label,
        found.cost,
        found.iterations,
        seconds,
        found.certificate.seconds,
        found.referee.cost,
        found.referee.survives,
        _where(found),
    )


def _where(found: Solution) -> str:
    """Return a text of the stage and status at which a solve ended, and the most violated constraint."""
    last = found.stages[-1]
    text = f"stage {len(found.stages)}, {last.label} {last.value:.1e}: {last.status}"
    for off in found.audit.worst[:1]:
        text += f"; {off.name} {off.component} at step {off.step} off by {off.amount:.1e}"
    return text


def row(starts: Sequence[Start]) -> list[str]:
    """Return the table's row of one problem; medians are over all starts, failed ones too."""
    good = sorted((start for start in starts if start.audited), key=lambda start: start.cost)
    best, worst = (good[0].cost, good[-1].cost) if good else (math.nan, math.nan)
    close = sum(start.cost <= best + 0.01 * abs(best) for start in good)
    refereed = good[0] if good else starts[0]
    own, floor = starts[0], FLOORS.get(starts[0].problem)
    return [
        f"`{own.problem}`",
        str(own.steps),
        str(own.pairs),
        str(audited(starts)),
        str(certified(starts)),
        "solved" if own.success else own.status,
        f"{median(start.iterations for start in starts):.0f}",
        f"{median(start.seconds for start in starts):.2g}",
        f"{median(start.certificate_s for start in starts):.2g}",
        f"{best:.6g}",
        f"{worst:.6g}",
        f"{close} of {len(starts)}",
        f"{refereed.referee:.6g}",
        {True: "yes", False: "no", None: "–"}[refereed.survives],
        str(floor or ""),
    ]


def audited(starts: Sequence[Start]) -> int:
    """Return how many of the perturbed starts pass the audit."""
    return sum(start.audited for start in starts if start.index > 0)


def certified(starts: Sequence[Start]) -> int:
    """Return how many of the perturbed starts are certified as stationary."""
    return sum(start.success for start in starts if start.index > 0)


def merged(old: Sequence[Sequence[str]], fresh: Sequence[Sequence[str]]) -> list[list[str]]:
    """Return rows in the order of the registry; new ones replace the old ones of their problems."""
    rows = {cells[0]: list(cells) for cells in (*old, *fresh)}
    return [rows[key] for name in (*names(), *FILES) if (key := f"`{name}`") in rows]


def store(fresh: Sequence[Sequence[str]]) -> None:
    """Write rows into the table of the site."""
    old = read(TABLE)["rows"] if (DATA / f"{TABLE}.json").exists() else []
    write_table(
        TABLE,
        title="Exact-law solves from 21 guesses",
        command="make bench-solve",
        columns=COLUMNS,
        rows=merged(old, fresh),
    )


def measured(chosen: Sequence[str]) -> Iterator[list[Start]]:
    """Yield all starts of one problem after the other, from two processes that share nothing."""
    with ProcessPoolExecutor(WORKERS, mp_context=get_context("spawn")) as pool:
        indices = range(PERTURBED + 1)
        pending = [pool.map(from_guess, [name] * len(indices), indices) for name in chosen]
        for results in pending:
            yield list(results)


def main() -> int:
    """Measure, print failures at once, and store the table; return 1 if a floor is missed."""
    chosen = [spec(FILES.get(name, name)).name for name in sys.argv[1:]] or [*names(), *FILES]
    rows, missed = [], []
    for starts in measured(chosen):
        rows.append(row(starts))
        name = starts[0].problem
        print(
            f"{name}: {audited(starts)} audited, {certified(starts)} certified",
            file=sys.stderr,
            flush=True,
        )
        for start in starts:
            if not start.success:
                print(f"  start {start.index}: {start.status}; {start.where}", file=sys.stderr)
        if audited(starts) < FLOORS.get(name, 0):
            missed.append(f"{name}: {audited(starts)} of {PERTURBED}, floor {FLOORS[name]}")
        store(rows)
    for cells in rows:
        print("  ".join(cells))
    print("below the floor: " + "; ".join(missed) if missed else "every floor is met")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
