"""Cost of a plan by the inputs of all steps, as simulators: under our contact laws, and in MuJoCo."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from dynamics.contact import ContactLaw
from dynamics.systems import Signal
from ocp.errors import InputError, choose
from ocp.gradients.rollouts import RolloutObjective
from ocp.gradients.worlds.measures import NEARBY_REACH
from ocp.gradients.worlds.report import Question
from ocp.gradients.worlds.world import World
from ocp.judge.findings import Finding, make_finding
from ocp.problem.evaluation import Evaluation
from ocp.problem.problem import Problem
from ocp.simulators.mujoco_world import SOLREF_S, STEP_S, MujocoWorld
from ocp.simulators.replay import simulated_costs
from ocp.solution import Solution
from ocp.transcription.factories import make_law

PLAN_WORLDS = ("exact", "barrier", "adaptive", "randomized", "mujoco")
"""Names of the worlds in which a plan's gradient can be compared with that of the exact law."""
QUADRATURE_POINTS = 1 << 10
"""Number of rollouts under the exact law for each smoothed gradient of a plan."""
SHARPER = {"h": 0.5, "mu": 0.1, "sigma": 0.25, "stiffness": 4.0}
"""Mapping from settings of laws and systems to the factors by which they change in one refinement."""
N_DIRECTIONS = 3
"""Number of directions along which the gradient of a plan is judged."""
STATIONARY_SHARE = 1e-3
"""Largest gradient at an optimum, as a share of the gradient a tenth of the inputs' size away."""
COMPARED_POINTS = 4
"""Number of points near a plan at which the gradients by all inputs are compared."""
DIFFERENCE_SHARE = 1e-3
"""Amplitude of the central differences by all inputs, as a share of an input's characteristic size."""


def law_plan(problem: Problem, law: ContactLaw, values: Mapping[str, float], adjustable: Collection[str] = ()) -> World:
    """Return the mean cost over scenarios under a contact law, as a simulator of the inputs (n, N nu).

    The settings of the simulator are the parameters of the law and the ``adjustable`` ones among the ``values`` of the
    problem's parameters.
    """
    objective = RolloutObjective(problem, law).at({name: values[name] for name in problem.parameters.names})
    prefix = "contact."
    settings = {name: values[name] for name in adjustable}
    settings |= {key.removeprefix(prefix): v for key, v in objective.parameters.items() if key.startswith(prefix)}

    def roll_out(theta: np.ndarray, gradient: bool, named: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
        changed = objective.at({name if name in adjustable else prefix + name: v for name, v in named.items()})
        return changed.costs_and_gradients(theta, gradient)

    return World(
        law.name,
        lambda theta, **named: roll_out(theta, False, named)[0][:, None],
        lambda theta, **named: roll_out(theta, True, named)[1][:, None],
        settings,
        {name: factor for name, factor in SHARPER.items() if name in settings},
    )


def mujoco_plan(problem: Problem, values: Mapping[str, float]) -> World:
    """Return the mean cost over scenarios in MuJoCo, as a simulator of the inputs (n, N nu) without derivatives.

    Raises the errors of :class:`~ocp.simulators.mujoco_world.MujocoWorld`.
    """
    simulator, evaluation = MujocoWorld(problem, values), Evaluation(problem, dict(values))
    x0 = problem.initial_states(problem.parameters.pack(values))

    def simulate(theta: np.ndarray, step: float, solref: float) -> np.ndarray:
        inputs = np.repeat(theta.reshape(len(theta), problem.N, -1), len(x0), axis=0)
        costs = simulated_costs(simulator, evaluation, inputs, np.tile(x0, (len(theta), 1)), solref, step)
        return costs.reshape(len(theta), -1).mean(axis=1, keepdims=True)

    settings, sharper = {"step": STEP_S, "solref": SOLREF_S}, {"step": 0.5, "solref": 0.5}
    return World("mujoco", simulate, None, settings, sharper, versions={"mujoco": simulator.version})


def along(world: World, inputs: np.ndarray, directions: np.ndarray) -> World:
    """Return a simulator of the coordinates t (n, k) along ``directions`` (k, d), at ``inputs + t @ directions``."""
    differentiate = world.differentiate
    return replace(
        world,
        simulate=lambda t, **named: world.simulate(inputs + t @ directions, **named),
        differentiate=None
        if differentiate is None
        else lambda t, **named: differentiate(inputs + t @ directions, **named) @ directions.T,
    )


def plan_directions(exact: World, inputs: np.ndarray, sizes: np.ndarray, seed: int) -> dict[str, np.ndarray]:
    """Return directions (d,) at ``inputs`` (d,) that change them by their characteristic ``sizes`` (d,) on average.

    The first direction, g, is the gradient under the exact law, unless that vanishes, as at an optimum. The others,
    d1, d2, ..., are random.
    """
    names = [f"d{index + 1}" for index in range(N_DIRECTIONS)]
    rows = np.random.default_rng(seed).normal(size=(N_DIRECTIONS, inputs.size))
    gradient, beside = exact.gradient(np.array([inputs, inputs + 0.1 * sizes * rows[1]]))[:, 0] * sizes
    if np.linalg.norm(gradient) > STATIONARY_SHARE * np.linalg.norm(beside):
        names[0], rows[0] = "g", gradient
    return dict(zip(names, rows * sizes / np.sqrt(np.square(rows).mean(axis=1, keepdims=True)), strict=True))


def compare_gradients(world: World, exact: World, inputs: np.ndarray, sizes: np.ndarray, seed: int) -> Finding:
    """Return lengths and angle of two gradients by all ``inputs`` (d,), each times its characteristic size.

    They are compared at random points near ``inputs``, since plans often lie at kinks, where a contact begins.
    """
    points = inputs + NEARBY_REACH * sizes * np.random.default_rng(seed).normal(size=(COMPARED_POINTS, inputs.size))
    gradients, exact_gradients = (_scaled_gradients(simulator, points, sizes) for simulator in (world, exact))
    length, exact_length = (float(np.sqrt(np.square(rows).sum(axis=1).mean())) for rows in (gradients, exact_gradients))
    lengths = length * exact_length
    cosine = float((gradients * exact_gradients).sum(axis=1).mean()) / lengths if lengths > 0 else 0.0
    return make_finding("gradient-by-all-inputs", count=inputs.size, length=length, truth=exact_length, cosine=cosine)


def _scaled_gradients(world: World, points: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Return gradients (n, d) of a simulator by inputs in units of their sizes, by differences if it has none."""
    if world.differentiate is not None:
        return world.gradient(points)[:, 0] * sizes
    (n, d), steps = points.shape, DIFFERENCE_SHARE * np.diag(sizes)
    values = [world.rollout((points[:, None] + sign * steps).reshape(-1, d))[:, 0] for sign in (1, -1)]
    return (values[0] - values[1]).reshape(n, d) / (2 * DIFFERENCE_SHARE)


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
        if name.endswith(".py"):
            return read(name)
        choose("world", name, dict.fromkeys(PLAN_WORLDS))
        is_law = name != "mujoco"
        return law_plan(problem, make_law(name, {}, problem.system), values) if is_law else mujoco_plan(problem, values)

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
