"""Costs in MuJoCo of plans of the named machines: by their inputs, and by gains along them.

``python -m tests.benchmarks.robots.plans_in_mujoco`` measures all and rewrites the site's table.
"""

from __future__ import annotations

import time

from docs.generator.measured import write_table
from ocp import solve
from ocp.errors import InputError
from ocp.simulators.replay import ExternalReplay, replay_in_simulator
from ocp.solve.best_gains import best_gains, plan_of

TABLE = "plans-in-mujoco"
MACHINES = ("finger-disc", "spinner", "idto-hopper", "hopper")


def cell(replayed: ExternalReplay) -> str:
    """Return the cost in MuJoCo, bold where it is within 20 % of the plan's."""
    return f"**{replayed.cost:.4g}**" if replayed.keeps else f"{replayed.cost:.4g}"


def row(machine: str) -> list[str]:
    """Return machine, cost of its plan, and its costs in MuJoCo by inputs and by gains."""
    began = time.process_time()
    solution = solve(machine, "exact", effort="quick")
    problem, values = solution.problem, solution.values
    evaluation, plan = plan_of(solution, problem.exact_step)
    start = plan.x[:, 0], solution.cost
    inputs = cell(replay_in_simulator("mujoco", problem, plan.u, values, *start))
    try:
        gains = cell(replay_in_simulator("mujoco", problem, best_gains(evaluation, plan)[0], values, *start))
    except InputError as reason:
        gains = str(reason)
    cells = [machine, f"{solution.cost:.4g}", inputs, gains]
    print(*cells, f"{time.process_time() - began:.0f} s", flush=True)
    return cells


def main() -> None:
    """Measure all machines and write the table."""
    write_table(
        TABLE,
        title="Plans in MuJoCo",
        command="python -m tests.benchmarks.robots.plans_in_mujoco",
        columns=["machine", "plan", "inputs in MuJoCo", "gains in MuJoCo"],
        rows=[row(machine) for machine in MACHINES],
        note="Costs at default parameters, exact law, effort quick; bold within 20 % of the plan. Gains are those that"
        " `--until survives` tries along the plan.",
    )


if __name__ == "__main__":
    main()
