"""Which law should be the default: exact and barrier on every problem from ten perturbed guesses.

``make bench-laws`` runs it and rewrites the site's table; ``PROBLEMS="hopper push-1d"`` measures
some of them. Every plan is replayed by the referee, whose cost and verdict are compared.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from statistics import median

from docs.generator.measured import DATA, read, write_table
from ocp.problem.rollout import initial_guesses
from ocp.solve.judging import judge_outcome
from ocp.solve.solve import new_session
from problems import get, names

TABLE, LAWS = "default-law", ("exact", "barrier")
COLUMNS = (
    "problem",
    "law",
    "certified of 10",
    "survive of 10",
    "best referee cost",
    "median referee cost",
    "median s",
)
PERTURBED, SEED, WORKERS = 10, 0, 2


@dataclass(frozen=True)
class Answer:
    """Result of one plan under the referee; ``seconds`` of processor time include verification."""

    certified: bool
    survives: bool
    cost: float
    seconds: float


def answer(problem: str, law: str, index: int) -> Answer:
    """Solve from one guess as ``ocp solve`` does, with everything built anew."""
    session = new_session(get(problem), law)
    guess = initial_guesses(session.evaluation, PERTURBED + 1, SEED)[index]
    began = time.process_time()
    found = judge_outcome(session, session.solve(guess=guess), SEED)
    seconds = time.process_time() - began
    return Answer(found.success, bool(found.referee.survives), found.referee.cost, seconds)


def row(problem: str, law: str, answers: Sequence[Answer]) -> list[str]:
    """Return a row of the table; a plan whose replay stops costs infinity."""
    costs = [one.cost if math.isfinite(one.cost) else math.inf for one in answers]
    return [
        f"`{problem}`",
        law,
        str(sum(one.certified for one in answers)),
        str(sum(one.survives for one in answers)),
        f"{min(costs):.6g}",
        f"{median(costs):.6g}",
        f"{median(one.seconds for one in answers):.2g}",
    ]


def main() -> None:
    """Measure problem after problem, and store each row when it is ready."""
    for problem in sys.argv[1:] or names():
        old = read(TABLE)["rows"] if (DATA / f"{TABLE}.json").exists() else []
        with ProcessPoolExecutor(WORKERS, mp_context=get_context("spawn")) as pool:
            for law in LAWS:
                given = [problem] * PERTURBED, [law] * PERTURBED, range(1, PERTURBED + 1)
                fresh = row(problem, law, list(pool.map(answer, *given)))
                old = [cells for cells in old if cells[:2] != fresh[:2]] + [fresh]
                print("  ".join(fresh), flush=True)
        order = {(f"`{name}`", law): i for i, (name, law) in enumerate((name, law) for name in names() for law in LAWS)}
        write_table(
            TABLE,
            title="Exact and barrier under the referee",
            command="make bench-laws",
            columns=COLUMNS,
            rows=sorted(old, key=lambda cells: order[cells[0], cells[1]]),
        )


if __name__ == "__main__":
    main()
