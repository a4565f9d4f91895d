"""Default solves of random instances against every other way we have of solving them.

``make bench-random`` runs it; ``COUNT=5 PROBLEMS="push-1d"`` draws fewer. What the other ways found
is kept in ``runs/bench-random.json``, so that a changed default route is measured at once;
``--fresh`` forgets it.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median

import numpy as np

from docs.generator.measured import write_table
from dynamics.contact import Barrier, Exact
from ocp.judge.constraints import broken_constraints
from ocp.problem.evaluation import Evaluation
from ocp.problem.rollout import Rollout, initial_guesses
from ocp.programs.solver import Status
from ocp.routes.complementarity import RelaxationPlan, by_strategy
from ocp.routes.homotopy import Homotopy, RouteResult
from ocp.routes.relaxations import CentralPath
from ocp.routes.session import Session
from ocp.solution import Solution
from ocp.solve.judging import judge_outcome
from ocp.solve.solve import new_session, solve
from ocp.transcription import Method, MultipleShooting, SingleShooting
from problems import get
from tests.benchmarks.ocp.random_draws import PROBLEMS, Instance, drawn

STORE = Path("runs/bench-random.json")
SEED, STARTS = 0, 4
LIMIT_S = 60.0
WORSE, MOST_WORSE, MOST_TIME = 0.01, 0.03, 1.5
BASELINE = "first strategy alone"
FEASIBLE = {s.label for s in (Status.SOLVED, Status.NOT_OPTIMAL, Status.UNDECIDED, Status.NO_PROGRESS)}


@dataclass(frozen=True)
class Answer:
    """Result of one way to solve an instance: cost, processor seconds of the solve, and wall seconds.

    ``certified`` is the certificate's own verdict; ``misplaced`` by how much [m] an audited
    ball-throw violates a bound or is deeper in the ground than its model allows at a node.
    """

    status: str
    certified: bool
    cost: float
    seconds: float
    wall: float
    misplaced: float = 0.0

    @property
    def solved(self) -> bool:
        """Whether the status is solved."""
        return self.status == Status.SOLVED.label


def default(instance: Instance) -> Answer:
    """Solve by the default route from the problem's own guess."""
    return _from_session(instance, lambda session: session.solve())


def alone(instance: Instance) -> Answer:
    """Solve by the first strategy alone, without other starts and improvement: the baseline of times."""

    def run(session: Session) -> RouteResult:
        follower = Homotopy(session.nlp_of, session.solver, session.values)
        plan = RelaxationPlan(CentralPath(), session.problem.natural_scales.mu, session.first_point)
        return by_strategy(follower, plan, plan.strategy)

    return _from_session(instance, run)


def _from_session(
    instance: Instance,
    run: Callable[[Session], RouteResult],
    settings: dict[str, str] | None = None,
    method: Method | str = "direct",
) -> Answer:
    problem = get(instance.problem, **instance.params)
    session = new_session(problem, Exact(), method, settings=settings)
    began, wall = time.process_time(), time.perf_counter()
    outcome = run(session)
    spent = time.process_time() - began, time.perf_counter() - wall
    return _answer(judge_outcome(session, outcome, SEED), *spent)


def _strategy(name: str) -> Callable[[Instance], Answer]:
    return lambda instance: _from_session(instance, lambda session: session.solve(), {"strategy": name})


def _start(number: int) -> Callable[[Instance], Answer]:
    def run(session: Session) -> RouteResult:
        return session.solve(guess=initial_guesses(session.evaluation, number + 1, SEED)[number])

    return lambda instance: _from_session(instance, run)


def _from_barrier(instance: Instance) -> Answer:
    """Solve under the exact law from a solution under the barrier law."""
    problem = get(instance.problem, **instance.params)
    began, wall = time.process_time(), time.perf_counter()
    soft = solve(problem, Barrier(mu=1e-6))
    found = solve(problem, Exact(), warm_start=soft)
    return _answer(found, time.process_time() - began, time.perf_counter() - wall)


def _shooting(method: MultipleShooting | SingleShooting) -> Callable[[Instance], Answer]:
    return lambda instance: _from_session(instance, lambda session: session.solve(), method=method)


SHOOTING = ("multiple shooting", "single shooting")
OTHERS: dict[str, Callable[[Instance], Answer]] = {
    "scholtes-adaptive": _strategy("scholtes-adaptive"),
    "scholtes": _strategy("scholtes"),
    **{f"start {k}": _start(k) for k in range(1, STARTS + 1)},
    "from barrier": _from_barrier,
    "multiple shooting": _shooting(MultipleShooting()),
    "single shooting": _shooting(SingleShooting()),
}


def _answer(found: Solution, seconds: float, wall: float) -> Answer:
    label, misplaced = found.status.label, 0.0
    if found.problem.name == "ball-throw" and label in FEASIBLE:
        misplaced = _misplaced(found)
    return Answer(label, found.certificate.certified, found.cost, seconds, wall, misplaced)


def _misplaced(found: Solution) -> float:
    """Return by how much an audited throw violates a bound, or is below the lowest node of a bounce.

    A node is at ``-R(s)`` if the free one would be lower. At speed V that needs a node before at
    ``c <= h V (1 - e) / (1 + e)`` and, one earlier, ``s = c + h V <= 2 h V / (1 + e)``, so that
    ``R(s) <= 2 e h V / (1 + e) + 2 g h^2 / (1 + e)``, plus the effect of gravity in two steps.
    """
    problem, values = found.problem, found.values
    x, u, lam, gap = (found.data[name].values for name in ("x", "u", "lam", "gap"))
    broken = broken_constraints(Evaluation(problem, values), Rollout(x, u, lam, gap, lam, np.zeros(len(x))))
    e, g, h = (values[name] for name in ("restitution", "g", "h"))
    fastest = np.sqrt(x[..., 5].max())
    deep = 2 * (e * h * fastest + g * h**2) / (1 + e) + 3 * g * h**2
    below = max(0.0, -float(x[..., 1].min()) - deep)
    return max([below, *(one.violation.amount for one in broken)])


def measured(
    instance: Instance, kept: dict[str, dict], now: dict[str, Callable[[Instance], Answer]]
) -> dict[str, Answer]:
    """Return all answers of an instance: those of ``now`` anew, others only if they are not stored."""
    ways = {**OTHERS, **now}
    found = {}
    for name, way in ways.items():
        if name in now or name not in kept:
            kept[name] = asdict(way(instance))
        found[name] = Answer(**kept[name])
    return found


@dataclass(frozen=True)
class Summary:
    """Counts over instances that the floors need."""

    count: int
    solved: int
    worse: int
    shot: int
    uncertified: int
    slow: int
    misplaced: int
    seconds: float
    ratio: float

    @property
    def missed(self) -> list[str]:
        """Texts on the floors that are missed."""
        floors = {
            f"more than 1 % above the best: {self.worse} of {self.solved} solved, floor 3 %": (
                self.worse > MOST_WORSE * self.solved
            ),
            f"{self.uncertified} shooting answers solved without a certificate": self.uncertified,
            f"{self.slow} solves of over {LIMIT_S:g} s where direct needs 1 s": self.slow,
            f"{self.misplaced} audited throws off a bound or in the ground": self.misplaced,
            f"{self.ratio:.2f} times the baseline's median time, floor {MOST_TIME}": (self.ratio > MOST_TIME),
        }
        return [words for words, wrong in floors.items() if wrong]


def best(answers: dict[str, Answer]) -> float:
    """Return the lowest certified cost over all ways, infinite if there is none."""
    return min((a.cost for a in answers.values() if a.solved and a.certified), default=math.inf)


def is_worse(answers: dict[str, Answer]) -> bool:
    """Return whether the default route's answer is solved and more than 1 % above the best."""
    low, own = best(answers), answers["default"]
    return own.solved and own.cost > low + WORSE * abs(low)


def summary(found: Sequence[dict[str, Answer]]) -> Summary:
    """Return counts over instances, and the ratio of median processor times to the baseline."""
    shots = [answers[name] for answers in found for name in SHOOTING]
    slow = [
        answer
        for answers in found
        for answer in answers.values()
        if answer.wall > LIMIT_S and answers["default"].wall <= 1.0
    ]
    own, base = (median(answers[name].seconds for answers in found) for name in ("default", BASELINE))
    return Summary(
        len(found),
        sum(answers["default"].solved and answers["default"].certified for answers in found),
        sum(is_worse(answers) for answers in found),
        sum(shot.solved for shot in shots),
        sum(shot.solved and not shot.certified for shot in shots),
        len(slow),
        sum(a.misplaced > 1e-6 for answers in found for a in answers.values()),
        own,
        own / base,
    )


COLUMNS = (
    "problem",
    "instances",
    "solved and certified",
    "> 1 % above the best",
    "shooting solved",
    "of them uncertified",
    "over 60 s",
    "misplaced",
    "median s",
    "of the baseline's",
)


def row(name: str, s: Summary) -> list[str]:
    """Return a line of the table."""
    cells = (
        name,
        s.count,
        s.solved,
        s.worse,
        s.shot,
        s.uncertified,
        s.slow,
        s.misplaced,
        f"{s.seconds:.2g}",
        f"{s.ratio:.2f}",
    )
    return [str(cell) for cell in cells]


def main() -> int:
    """Measure, print worse answers at once, and store the table; return 1 if a floor is missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("problems", nargs="*", metavar="PROBLEM", choices=[*PROBLEMS, []])
    parser.add_argument("--count", type=int, default=30, help="instances a problem")
    parser.add_argument("--seed", type=int, default=SEED, help="of the instances")
    parser.add_argument("--fresh", action="store_true", help="forget what other ways found")
    given = parser.parse_args()
    store: dict[str, dict] = {}
    if STORE.exists() and not given.fresh:
        store = json.loads(STORE.read_text())
    now = {"default": default, BASELINE: alone}
    every: dict[str, list[dict[str, Answer]]] = {}
    for name in given.problems or PROBLEMS:
        every[name] = []
        for instance in drawn(name, given.count, given.seed):
            answers = measured(instance, store.setdefault(instance.key, {}), now)
            every[name].append(answers)
            _keep(store)
            _tell(instance, answers)
    total = summary([answers for found in every.values() for answers in found])
    rows = [*(row(f"`{name}`", summary(found)) for name, found in every.items()), row("all", total)]
    for cells in rows:
        print("  ".join(cells))
    if not given.problems:
        write_table(
            "random-instances",
            title="Instances with drawn parameters",
            command=f"make bench-random COUNT={given.count} SEED={given.seed}",
            columns=COLUMNS,
            rows=rows,
        )
    print("missed: " + "; ".join(total.missed) if total.missed else "every floor is met")
    return 1 if total.missed else 0


def _tell(instance: Instance, answers: dict[str, Answer]) -> None:
    own, low = answers["default"], best(answers)
    if is_worse(answers) or not own.solved:
        ways = [name for name, a in answers.items() if a.solved and a.cost <= low + WORSE * abs(low)]
        print(
            f"{instance.problem} {instance.index}: {own.status} {own.cost:.6g}, best {low:.6g} by"
            f" {', '.join(ways) or 'none'}; {instance.command}",
            file=sys.stderr,
            flush=True,
        )


def _keep(store: dict[str, dict]) -> None:
    STORE.parent.mkdir(exist_ok=True)
    fresh = STORE.with_suffix(".new")
    fresh.write_text(json.dumps(store))
    fresh.replace(STORE)


if __name__ == "__main__":
    sys.exit(main())
