"""Cost of a problem by the inputs of all steps, as simulators: under our contact laws, and in MuJoCo."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace

import numpy as np

from dynamics.contact import ContactLaw
from ocp.gradients.rollouts import RolloutObjective
from ocp.gradients.worlds.measures import NEARBY_REACH
from ocp.gradients.worlds.world import World
from ocp.judge.findings import Finding, make_finding
from ocp.problem.evaluation import Evaluation
from ocp.problem.problem import Problem
from ocp.simulators.mujoco_world import SOLREF_S, STEP_S, MujocoWorld
from ocp.simulators.replay import simulated_costs

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
