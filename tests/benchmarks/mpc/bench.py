"""Reference tasks in closed loop: ``python -m tests.benchmarks.mpc.bench [WORD ...]``.

``make bench-mpc`` runs all and rewrites the site's tables; ``TASKS="soft-walls spinner"`` measures
those whose name has one of the words. Every task runs on the exact law at the model's step size, by
the controller and a plain Opti loop; then other solvers solve one sample's quadratic program.
"""

from __future__ import annotations

import sys
import time
import warnings
from dataclasses import dataclass

import numpy as np

from docs.generator.measured import DATA, read, table, write_table
from ocp.mpc.controller import Command, Controller
from ocp.mpc.simulate import ClosedLoop, simulate
from ocp.mpc.stages import Plan
from tests.benchmarks.mpc import opti_loop, programs
from tests.benchmarks.mpc.check import Check
from tests.benchmarks.mpc.tasks import SKIP, TASKS, Task

COLUMNS = (
    "task",
    "samples",
    "p50 ms",
    "p99 ms",
    "floor ms",
    "starts",
    "cost, over that of",
    "certified",
    "disproved",
    "Opti p50 ms",
    "p99 ms ",
    "samples ",
    "p99 over ours",
    "published",
)
PEER_S = 25.0
"""Time limit [s] of the Opti loop in a task."""


@dataclass
class Judged:
    """A closed loop, and its plans with a certificate, each with its sample's parameter values."""

    loop: ClosedLoop
    plans: dict[tuple[int, int], tuple[Plan, dict[str, float]]]

    @property
    def kinds(self) -> dict[tuple[int, int], str]:
        """Stationarity by the certificate of each plan."""
        found = self.loop.data["certificate"].values
        return {at: str(found[at]) for at in self.plans}


def driven(task: Task, controller: Controller, x0: np.ndarray) -> Judged:
    """Return the closed loop from all starts, and its certified samples' plans."""
    plans: dict[tuple[int, int], tuple[Plan, dict[str, float]]] = {}

    def keep(seed: int, k: int, command: Command) -> None:
        if task.certify and k % task.certify == 0 and command.plan is not None:
            plans[seed, k] = command.plan, controller.values_of_sample

    loop = simulate(
        controller,
        task.steps,
        task.plant,
        disturbance=task.disturbance,
        seeds=len(x0),
        x0=x0,
        goals=task.goals,
        certify=task.certify,
        progress=keep,
    )
    return Judged(loop, plans)


def bold(text: str, missed: bool) -> str:
    """Return text in bold if its floor is missed."""
    return f"**{text}**" if missed else text


def outcome(task: Task, loop: ClosedLoop, x0: np.ndarray) -> str:
    """Return from how many starts the outcome was reached, without those that the Opti loop misses too."""
    good = task.outcome(loop.data["x"].values)
    counted = np.ones(len(x0), dtype=bool)
    if task.needed < 1:
        for s in np.flatnonzero(~good):
            counted[s] = opti_loop.run(task, np.inf, x0[s : s + 1]).reached
    left = f" ({np.sum(~counted)} neither)" if not counted.all() else ""
    text = f"{task.says} {good[counted].sum()} of {counted.sum()}{left}"
    if task.came:
        text += f", comes {task.came(loop.data['x'].values).sum()}"
    return bold(text, not (good[0] and good[counted].mean() >= task.needed))


def compared(task: Task, loop: ClosedLoop, x0: np.ndarray) -> str:
    """Return the loop's cost relative to that of another phase, from the first starts."""
    if not np.isfinite(task.ratio):
        return ""
    chosen = x0[: task.compared]
    other = Controller(task.made(), phase=task.against, trust=task.trust)
    loop_ = simulate(other, task.steps, goals=task.goals, seeds=len(chosen), x0=chosen)
    ratios = loop.costs[: task.compared] / loop_.costs
    text = f"{np.median(ratios):.4g} {task.against} ({loop_.costs[0]:.4g})"
    if task.compared > 1:
        text += f", at most {np.max(ratios):.4g}"
    return bold(text, not np.median(ratios) <= task.ratio)


def beside(peer: opti_loop.PeerLoop, p99: float) -> list[str]:
    """Return the cells of the Opti loop."""
    return [
        f"{1e3 * peer.percentile(50):.1f}",
        f"{1e3 * peer.percentile(99):.1f}",
        f"{peer.seconds.size}" + (f", {peer.failed} failed" if peer.failed else ""),
        f"{peer.percentile(99) / p99:.1f}",
    ]


def measured(task: Task) -> tuple[list[str], int, int]:
    """Return a row of the table, and the numbers of certified and of disproved plans."""
    began = time.perf_counter()
    controller = Controller(task.made(), trust=task.trust, iterations=task.iterations)
    x0 = task.drawn(controller.start)
    found = driven(task, controller, x0)
    loop, kinds = found.loop, found.kinds
    check = Check(controller) if kinds else None
    certified = [at for at, kind in kinds.items() if kind in ("B", "KKT")]
    steep = {at: check.disproof(*found.plans[at]) for at in certified if check}
    wrong = [at for at, value in steep.items() if value]
    p50, p99 = (loop.percentile(share, SKIP) for share in (50, 99))
    peer = opti_loop.run(task, PEER_S, x0, task.peer) if task.peer else None
    count = int(np.isfinite(loop.data["seconds"].values[:, SKIP:]).sum())
    row = [
        task.name,
        str(count),
        f"{1e3 * p50:.2f}",
        bold(f"{1e3 * p99:.2f}", p99 > task.floor),
        f"{1e3 * task.floor:g}",
        outcome(task, loop, x0),
        compared(task, loop, x0),
        f"{len(certified)} of {len(kinds)}" if kinds else "",
        bold(str(len(wrong)), bool(wrong)) if kinds else "",
        *([""] * 4 if peer is None else beside(peer, p99)),
        task.published,
    ]
    told(task, found, wrong, steep, time.perf_counter() - began)
    return row, len(certified), len(wrong)


def told(
    task: Task,
    found: Judged,
    wrong: list[tuple[int, int]],
    steep: dict[tuple[int, int], float],
    seconds: float,
) -> None:
    """Print what the table leaves out: statuses, notes, and starts that missed the outcome."""
    loop = found.loop
    statuses = dict(zip(*np.unique(loop.data["status"].values, return_counts=True), strict=True))
    kinds = dict(zip(*np.unique(list(found.kinds.values()), return_counts=True), strict=True))
    print(f"\n{task.name}: {seconds:.0f} s, cost from the given start {loop.costs[0]:.6g}")
    for what, counts in (("samples", statuses), ("certificates", kinds), ("told", loop.notes)):
        print(f"  {what}: " + ", ".join(f"{n} {kind}" for kind, n in counts.items()))
    missed = np.flatnonzero(~task.outcome(loop.data["x"].values))
    ends = loop.data["x"].values[np.arange(len(loop.costs)), loop.data["ended"].values]
    for s in missed[:8]:
        print(
            f"  not {task.says}: start {s}, ended after {loop.data['ended'].values[s]} samples"
            f" at {np.round(ends[s], 3).tolist()}"
        )
    for at in wrong[:8]:
        print(f"  disproved: start {at[0]}, sample {at[1]}, {steep[at]:.2g} times what is zero")
    sys.stdout.flush()


def main(words: list[str]) -> None:
    """Measure task after task and store each row, then measure the programs."""
    warnings.simplefilter("ignore")
    total = [0, 0]
    for task in TASKS.values():
        if words and not any(word in task.name for word in words):
            continue
        row, certified, wrong = measured(task)
        total = [total[0] + certified, total[1] + wrong]
        old = read("mpc")["rows"] if (DATA / "mpc.json").exists() else []
        rows = [cells for cells in old if cells[0] != row[0]] + [row]
        order = list(TASKS)
        write_table(
            "mpc",
            title="Closed loop",
            command="make bench-mpc",
            columns=COLUMNS,
            rows=sorted(rows, key=lambda cells: order.index(cells[0])),
        )
        print(table(COLUMNS, [row]), flush=True)
    print(f"{total[0]} plans certified, {total[1]} of them disproved")
    if not words or "programs" in words:
        programs.main()


if __name__ == "__main__":
    main([word for text in sys.argv[1:] for word in text.split(",") if word])
