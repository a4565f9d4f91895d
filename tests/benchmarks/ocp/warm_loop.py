"""Quick solves against a plain warm Scholtes loop: ``python -m tests.benchmarks.ocp.warm_loop [WORD ...]``.

The loop solves ``lam gap <= t`` for t from 1 to 1e-8, in characteristic units, by factors of 0.1, each stage from the
point and multipliers of the last one, on the workbench's own program, which is faster than a script's. It ends there:
it has no branch, no neighbours and no other path. Compared are processor times from parameters to plan, medians of five
alternating rounds, and costs; judging is left out of both. The table is printed.
"""

from __future__ import annotations

import sys
import time
from statistics import median

from docs.generator.measured import table
from ocp.routes.complementarity import follow_paths
from ocp.routes.homotopy import Homotopy, HomotopyPath
from ocp.routes.relaxations import relaxed
from ocp.solve.solve import new_session
from tests.benchmarks.ocp.random_draws import PROBLEMS

NAMES = (*PROBLEMS, "planar-hand", "finger-disc")
"""Twelve named problems that a loop solves in seconds."""
ROUNDS, FLOOR, WORSE = 5, 1.3, 1e-6
"""Rounds, largest ratio of times, and relative difference of costs above which a plan is worse."""
WARM = {"mu_init": 1e-6, "bound_relax_factor": 1e-8, "max_iter": 300}
"""IPOPT options of all stages after the first."""


def loop(name: str) -> float:
    """Return the cost by the loop, infinity if a stage fails."""
    session = new_session(name)
    follower, mu = Homotopy(session.nlp_of, session.solver, session.values), session.problem.natural_scales.mu
    path = HomotopyPath([mu * 10.0**-k for k in range(9)], lambda t: relaxed(t, WARM if t < mu else {}))
    program = session.nlp_of(path.reformulation)
    followed = follow_paths(follower, [path], session.first_point(program), program, step_backs=0)
    return (
        followed.result.f + program.constant(program.parameter_vector(session.values))
        if followed.finished
        else float("inf")
    )


def quick(name: str) -> float:
    """Return the cost by the usual route at quick effort, without judging."""
    session = new_session(name)
    session.effort = "quick"
    outcome = session.solve()
    return outcome.result.f + outcome.nlp.constant(outcome.nlp.parameter_vector(session.values))


def main() -> None:
    """Measure and print the table."""
    rows = []
    for name in (name for name in NAMES if not sys.argv[1:] or any(word in name for word in sys.argv[1:])):
        seconds: dict[str, list[float]] = {"quick": [], "loop": []}
        costs: dict[str, float] = {}
        for _ in range(ROUNDS):
            for way, solve in (("quick", quick), ("loop", loop)):
                start_time = time.process_time()
                costs[way] = solve(name)
                seconds[way].append(time.process_time() - start_time)
        ours, theirs = median(seconds["quick"]), median(seconds["loop"])
        ratio, is_worse = ours / theirs, costs["quick"] > costs["loop"] + WORSE * abs(costs["loop"])
        shown = f"{'**' * is_worse}{costs['quick']:.7g}{'**' * is_worse}"
        missed = "**" * (ratio > FLOOR)
        rows.append([f"`{name}`", ours, theirs, f"{missed}{ratio:.2f}{missed}", shown, costs["loop"]])
        print(*rows[-1], flush=True)
    print(table(("problem", "quick CPU s", "loop CPU s", f"ratio (at most {FLOOR})", "cost", "cost of the loop"), rows))


if __name__ == "__main__":
    main()
