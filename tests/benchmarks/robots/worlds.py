"""Shares of plans and policies that keep their cost in MuJoCo, by machine and law, on perturbed tasks.

``python -m tests.benchmarks.robots.worlds`` measures all and rewrites the site's table; with
``hopper`` it measures that machine alone.
"""

from __future__ import annotations

import sys
import time
import warnings
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np

from docs.generator.measured import DATA, read, write_table
from dynamics.batch import BatchWarning
from dynamics.contact import Adaptive, Barrier, ContactLaw, Exact
from ocp.mpc import Controller, simulate
from ocp.problem.evaluation import Evaluation
from ocp.simulators.replay import KEPT_COST_SHARE, replay_in_simulator
from problems import get

TABLE = "worlds"
MACHINES = {"hopper": ("goal", 2), "idto-hopper": ("speed", 4), "spinner": ("rate", 4), "finger-disc": ("goal", 4)}
"""Parameter that is perturbed, and number of tasks, by machine."""
LAWS: dict[str, ContactLaw] = {
    "exact": Exact(),
    "barrier, mu = 0.001": Barrier(mu=1e-3),
    "adaptive": Adaptive(),
}
SPREAD, WORKERS = 0.1, 2
WAYS = ("inputs", "gains", "planning again")


def kept(task: tuple[str, str, int]) -> tuple[bool, ...]:
    """Return whether the inputs of a plan, gains along it, and replanning keep their costs."""
    machine, law, seed = task
    name = MACHINES[machine][0]
    share = 1 + SPREAD * np.random.default_rng(seed).uniform(-1, 1)
    problem = get(machine, **{name: share * get(machine).parameters.defaults[name]})
    values = problem.parameters.defaults
    with warnings.catch_warnings():
        # Candidates of a step that diverge are ignored: the plan keeps another.
        warnings.simplefilter("ignore", BatchWarning)
        along = Controller(problem, contact=LAWS[law], phase="policy")
        plan = along.current_plan
        x, u = plan.x[None], plan.u[None]
        cost = float(Evaluation(problem, values).trajectory_costs(x, u, plan.lam[None])[0])
        found = [replay_in_simulator("mujoco", problem, u, values, x[:, 0], cost).keeps]
        again = Controller(problem, contact=LAWS[law], phase="qpcc" if law == "exact" else "relaxed")
        for controller in (along, again):
            here, there = (float(simulate(controller, problem.N, plant).costs[0]) for plant in ("exact", "mujoco"))
            found.append(abs(there - here) <= KEPT_COST_SHARE * abs(here))
    return tuple(found)


def cell(found: Sequence[tuple[bool, ...]]) -> str:
    """Return the shares of all ways as text, in percent."""
    return " / ".join(f"{100 * np.mean(column):.0f}" for column in zip(*found, strict=True)) + " %"


def main() -> None:
    """Measure machine after machine, and store each column when it is ready."""
    old = read(TABLE) if (DATA / f"{TABLE}.json").exists() else {"columns": ["law"], "rows": []}
    cells = {
        (row[0], name): value
        for row in old["rows"]
        for name, value in zip(old["columns"][1:], row[1:], strict=True)
        if value
    }
    for machine in sys.argv[1:] or MACHINES:
        began, count = time.perf_counter(), MACHINES[machine][1]
        tasks = [(machine, law, seed) for law in LAWS for seed in range(count)]
        with ProcessPoolExecutor(WORKERS, mp_context=get_context("spawn")) as pool:
            found = list(pool.map(kept, tasks))
        for k, law in enumerate(LAWS):
            cells[law, machine] = cell(found[k * count : (k + 1) * count])
        print(machine, [cells[law, machine] for law in LAWS], f"{time.perf_counter() - began:.0f} s", flush=True)
        names = [name for name in MACHINES if any(at == name for _, at in cells)]
        write_table(
            TABLE,
            title="And in MuJoCo?",
            command="python -m tests.benchmarks.robots.worlds",
            columns=["law", *names],
            rows=[[law, *(cells[law, name] for name in names)] for law in LAWS],
            note="Shares of tasks, one parameter each by up to 10 % another, whose cost in MuJoCo"
            f" is within 20 % of what it is here: {', '.join(WAYS)}. Of"
            f" {', '.join(f'{name} {MACHINES[name][1]}' for name in names)} tasks.",
        )


if __name__ == "__main__":
    main()
