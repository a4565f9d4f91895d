"""Gradient of a plan's cost by its inputs: the simulators by name, and the derivatives to be judged."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from dynamics.systems import Signal
from ocp.errors import InputError, choose
from ocp.gradients.worlds.plans import along, compare_gradients, law_plan, mujoco_plan, plan_directions
from ocp.gradients.worlds.report import Question
from ocp.gradients.worlds.world import World
from ocp.judge.findings import Finding
from ocp.problem.problem import Problem
from ocp.solution import Solution
from ocp.transcription.factories import make_law
from problems.gradient_scenes.rigid_worlds import LAWS

Builder = Callable[[Problem, Mapping[str, float]], World]
"""Function from a problem and the values of its parameters to the cost of its rollouts as a simulator."""
PLAN_WORLDS: dict[str, Builder] = {
    **{
        name: lambda problem, values, name=name: law_plan(problem, make_law(name, {}, problem.system), values)
        for name in LAWS
    },
    "mujoco": mujoco_plan,
}
"""Mapping from the names of worlds in which a plan's gradient can be compared with that of the exact law."""
QUADRATURE_POINTS = 1 << 10
"""Number of rollouts under the exact law for each smoothed gradient of a plan."""


def plan_questions(
    solution: Solution, names: Sequence[str], read: Callable[[str], World], seed: int
) -> tuple[list[Question], list[World]]:
    """Return the derivatives of a plan's cost along directions of its inputs, and the simulators in ``names``.

    ``read`` loads a user's file, whose ``rollout(theta)`` maps the inputs (n, N nu) of all steps to costs (n, 1). The
    parameter is the distance along a direction; at 1 the inputs change by their characteristic size on average.

    Raises :class:`~ocp.errors.InputError` for an unknown name, and for a plan whose inputs or start are not those of
    the problem's rollouts.
    """
    problem, values = solution.problem, solution.values
    x, u = solution.data["x"].values, solution.data["u"].values
    if not (u == u[0]).all():
        raise InputError(
            f"the scenarios of {problem.name} have different inputs, by feedback; solve it with --policy open-loop"
        )
    if not np.allclose(x[:, 0], problem.initial_states(problem.parameters.pack(values))):
        raise InputError(f"the plan of {problem.name} chooses its own start; gradients are at the problem's start")
    inputs, sizes = u[0].ravel(), np.tile(problem.scales.u, problem.N)

    def build(name: str) -> World:
        return read(name) if name.endswith(".py") else choose("world", name, PLAN_WORLDS)(problem, values)

    exact, worlds = build("exact"), [build(name) for name in names]
    directions = plan_directions(exact, inputs, sizes, seed)
    rows = np.array(list(directions.values()))
    full_worlds = {world.name: world for world in worlds}

    def compare(world: World) -> list[Finding]:
        return [compare_gradients(full_worlds[world.name].at(world.settings), exact, inputs, sizes, seed)]

    questions = [
        Question(
            np.zeros(len(rows)),
            1.0,
            along(exact, inputs, rows),
            index,
            signals=(Signal(name, "1"), Signal("cost", "1")),
            points=QUADRATURE_POINTS,
            further_findings=compare if index == 0 else lambda world: [],
        )
        for index, name in enumerate(directions)
    ]
    return questions, [along(world, inputs, rows) for world in worlds]
