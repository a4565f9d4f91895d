"""Table of the cause of a plan's higher cost in MuJoCo: the plan, the model, or MuJoCo's discrete map.

``python -m tests.benchmarks.robots.errors_in_mujoco`` measures all machines and rewrites the site's table.
"""

from __future__ import annotations

import numpy as np

from docs.generator.measured import write_table
from dynamics.contact import Exact
from ocp import solve
from ocp.gradients.worlds import World
from ocp.gradients.worlds.plans import law_plan, mujoco_plan
from ocp.problem.evaluation import Evaluation
from ocp.simulators.replay import KEPT_COST_SHARE, SOLREF_BAND_S, STEP_BAND_S
from ocp.solution import Solution

TABLE = "errors-in-mujoco"
MACHINES = ("finger-disc", "spinner", "idto-hopper", "hopper")
LARGE_SHARE, SMALL_SHARE = 1e-2, 1e-4
"""Changes of all inputs, as shares of their characteristic sizes."""
N_CHANGES = 8
"""Number of random changes of the inputs."""


def shift(world: World, solution: Solution, evaluation: Evaluation, share: float) -> float:
    """Return the median change of a plan's cost in a world where inputs change by ``share`` of their sizes at random.

    It is a share of what a plan can change of the cost.
    """
    u = solution.data["u"].values[0].ravel()
    sizes = share * np.tile(solution.problem.scales.u, solution.problem.N)
    rows = np.vstack([u, u + sizes * np.random.default_rng(0).normal(size=(N_CHANGES, u.size))])
    costs = world.rollout(rows)[:, 0]
    return evaluation.cost_share(float(np.median(np.abs(costs[1:] - costs[0]))), solution.cost)


def whose_error(machine: str) -> list[str]:
    """Return a plan's costs and their shifts under the exact law and in MuJoCo, and whose error the difference is.

    It is the plan's if small changes of its inputs already cost more under the exact law, the world's sawtooth if
    changes of a hundredth of these cost more in MuJoCo alone, the softness of contact if hard contact and short steps
    keep the cost, and the model's otherwise.
    """
    solution = solve(machine, "exact", effort="quick")
    problem, values = solution.problem, solution.values
    evaluation, world = Evaluation(problem, dict(values)), mujoco_plan(problem, values)
    inputs = solution.data["u"].values[:1].reshape(1, -1)
    by_law = shift(law_plan(problem, Exact(), values), solution, evaluation, LARGE_SHARE)
    by_map = shift(world, solution, evaluation, SMALL_SHARE)
    hard = world.at({"solref": SOLREF_BAND_S[0], "step": STEP_BAND_S[0]})
    costs = [float(each.rollout(inputs)[0, 0]) for each in (world, hard)]
    keeps = [evaluation.cost_share(abs(cost - solution.cost), solution.cost) <= KEPT_COST_SHARE for cost in costs]
    causes = {
        "–": keeps[0],
        "plan": by_law > KEPT_COST_SHARE,
        "sawtooth": by_map > KEPT_COST_SHARE,
        "softness": keeps[1],
    }
    cause = next((name for name, applies in causes.items() if applies), "model")
    shares = [f"{float(f'{100 * each:.2g}'):g} %" for each in (by_law, by_map)]
    cells = [machine, *(f"{cost:.4g}" for cost in (solution.cost, *costs)), *shares, cause]
    print(*cells, sep=" | ", flush=True)
    return cells


def main() -> None:
    """Measure all machines and write the table."""
    write_table(
        TABLE,
        title="Whose error is it?",
        command="python -m tests.benchmarks.robots.errors_in_mujoco",
        columns=["machine", "plan", "in MuJoCo", "hard contact", "1 %, exact law", "0.01 %, MuJoCo", "whose error"],
        rows=[whose_error(machine) for machine in MACHINES],
        note="Costs of inputs at default parameters, exact law, effort quick; *hard contact*: with time constants of"
        " 5 ms and steps of 0.5 ms. *1 %*: median change of the cost under the exact law where all inputs change by"
        " 1 % of their sizes at random, *0.01 %*: in MuJoCo where they change by a hundredth of that, as shares of what"
        " a plan can change.",
    )


if __name__ == "__main__":
    main()
