"""Costs in MuJoCo of plans of the named machines: by inputs, by gains, by gains improved there, and by a controller.

``python -m tests.benchmarks.robots.plans_in_mujoco [MACHINE...]`` measures all or some machines, and rewrites the
site's table row by row. Cells that take more than ``LIMIT_S`` of processor time stay empty.
"""

from __future__ import annotations

import signal
import sys
import time
import warnings
from collections.abc import Callable

import numpy as np

from docs.generator.measured import DATA, read, write_table
from dynamics.batch import BatchWarning
from ocp import solve
from ocp.errors import InputError
from ocp.mpc.plan_policies import ControllerPolicy
from ocp.problem.evaluation import Evaluation
from ocp.simulators.mujoco_world import MujocoWorld
from ocp.simulators.replay import KEPT_COST_SHARE
from ocp.solve.best_gains import best_gains, plan_of
from ocp.solve.shared_gains import Merit
from ocp.solve.simulator_gains import SimulatorOutcomes, gains_in_simulator

TABLE = "plans-in-mujoco"
COLUMNS = ("machine", "plan", "inputs", "gains", "gains improved in MuJoCo", "planning again")
MACHINES = (
    "finger-disc",
    "spinner",
    "idto-hopper",
    "hopper",
    "half-cheetah",
    "push-cube",
    "reorient",
    "ant",
    "quadruped",
)
LIMIT_S = 90
"""Seconds of processor time of one cell."""


class _LimitError(Exception):
    """Error raised when a cell has taken its time."""


def _stop(*_: object) -> None:
    raise _LimitError


def limited(merit: Callable[[], Merit], plan: float, kept: Callable[[float], bool]) -> str | None:
    """Return a cost in MuJoCo as text, bold where it is kept; None beyond the limit of time.

    It is kept if it is at most 20 % above the plan's and no constraint is violated.
    """
    signal.signal(signal.SIGPROF, _stop)
    signal.setitimer(signal.ITIMER_PROF, LIMIT_S)
    try:
        violated, _, _, value = merit()
    except _LimitError:
        return None
    except (InputError, np.linalg.LinAlgError) as reason:
        return str(reason)
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
    if not np.isfinite(value):
        return "diverges"
    if violated:
        return f"{value:.4g}, {violated} violated"
    return f"**{value:.4g}**" if value <= plan or kept(value - plan) else f"{value:.4g}"


def _merit_of_controller(merit: Callable[..., Merit], evaluation: Evaluation) -> Merit:
    policy = ControllerPolicy(evaluation)
    controlled = merit(policy)
    if policy.n_unplanned == policy.samples:
        raise InputError("makes no plan")
    return controlled


def row(machine: str) -> list[str | None]:
    """Return machine, cost of its plan, and its costs in MuJoCo by each policy."""
    began = time.process_time()
    solution = solve(machine, "exact", effort="quick")
    problem, values = solution.problem, solution.values
    evaluation, plan = plan_of(solution, problem.exact_step)
    world = MujocoWorld(problem, values)
    merit = SimulatorOutcomes(evaluation, plan, world).merit

    def kept(excess: float) -> bool:
        return evaluation.cost_share(excess, solution.cost) <= KEPT_COST_SHARE

    ways: tuple[Callable[[], Merit], ...] = (
        lambda: merit(plan.u),
        lambda: merit(best_gains(evaluation, plan)[0]),
        lambda: merit(gains_in_simulator(evaluation, plan, world)),
        lambda: _merit_of_controller(merit, evaluation),
    )
    cells = [machine, f"{solution.cost:.4g}", *(limited(way, solution.cost, kept) for way in ways)]
    print(*cells, f"{time.process_time() - began:.0f} s", flush=True)
    return cells


def main() -> None:
    """Measure machine after machine, and store each row as it comes."""
    warnings.simplefilter("ignore", BatchWarning)
    for machine in sys.argv[1:] or MACHINES:
        fresh = row(machine)
        old = read(TABLE)["rows"] if (DATA / f"{TABLE}.json").exists() else []
        rows = [cells for cells in old if cells[0] != machine and len(cells) == len(COLUMNS)] + [fresh]
        write_table(
            TABLE,
            title="Plans in MuJoCo",
            command="python -m tests.benchmarks.robots.plans_in_mujoco",
            columns=COLUMNS,
            rows=sorted(rows, key=lambda cells: MACHINES.index(cells[0])),
            note="Costs at default parameters, exact law, effort quick; bold at most 20 % above the plan, with no"
            " constraint violated by a tenth of its size. *Gains* are"
            " those that `--until survives` tries along the plan; *planning again* is a receding-horizon controller at"
            " the plan's step. Cells"
            f" without a number took more than {LIMIT_S} s of processor time.",
        )


if __name__ == "__main__":
    main()
