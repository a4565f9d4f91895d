"""Time that a solve goes on after its answer: ``python -m tests.benchmarks.ocp.after_answer [WORD ...]``.

Solves the named problems at quick and normal effort, in processor time, and rewrites the table of the site; words
select problems. The answer is reached at the first stage of the solver whose cost is that of the returned plan. What
follows are neighbours, further paths and samples that brought nothing cheaper, and the judgement of the answer by
certificate, audit and referee, which a column of its own shows.
"""

from __future__ import annotations

import sys
import time
from statistics import median

from docs.generator.measured import write_table
from ocp import solve
from ocp.judge.route_report import StageRecord
from problems import names

FLOORS = {"quick": 0.25, "normal": 0.40}
"""Largest share of a solve that may follow its answer, its judgement included, by effort."""
SAME_COST = 1e-7
"""Relative difference of costs up to which a stage has reached the answer."""
SKIPPED = {"normal": ("half-cheetah", "quadruped", "ant", "push-cube", "reorient", "hopper")}
"""Problems that take minutes at an effort."""


def measured(name: str, effort: str) -> tuple[float, float, float]:
    """Return the processor seconds of a solve: in all, after its answer, and of the answer's judgement."""
    reached: list[tuple[float, float]] = []

    def record(stage: StageRecord) -> None:
        if stage.accepted:
            reached.append((time.process_time(), stage.cost))

    start_time = time.process_time()
    solution = solve(name, effort=effort, progress=record)
    end_time = time.process_time()
    limit = SAME_COST * abs(solution.cost)
    at = next((seconds for seconds, cost in reached if abs(cost - solution.cost) <= limit), end_time)
    return end_time - start_time, end_time - at, solution.route.audit_s


def main() -> None:
    """Measure both efforts, and print and store the table."""
    chosen = [name for name in names() if not sys.argv[1:] or any(word in name for word in sys.argv[1:])]
    solve("wall-1d", effort="normal")  # Imports and compiled rollouts are not what is measured.
    rows = []
    for effort, floor in FLOORS.items():
        shares = []
        for name in (name for name in chosen if name not in SKIPPED.get(effort, ())):
            total, after, judging = measured(name, effort)
            shares.append(after / total)
            seconds = [f"{value:.2f}" for value in (total, after - judging, judging)]
            rows.append([f"`{name}`", effort, *seconds, f"{shares[-1]:.0%}"])
            print(*rows[-1], flush=True)
        missed = median(shares) > floor
        rows.append(["median", effort, "", "", "", f"{'**' * missed}{median(shares):.0%}{'**' * missed}"])
    write_table(
        "after-answer",
        title="Time after the answer",
        command="python -m tests.benchmarks.ocp.after_answer",
        columns=("problem", "effort", "CPU s", "searching after the answer", "judging it", "both, of the solve"),
        rows=rows,
        note=f"Goals are a median of {FLOORS['quick']:.0%} at quick and {FLOORS['normal']:.0%} at normal effort.",
    )


if __name__ == "__main__":
    main()
