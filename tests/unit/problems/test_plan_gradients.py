"""Gradients of plans: costs and slopes against closed forms, another implementation, differences, and MuJoCo."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest

from dynamics.contact import Barrier, Exact
from dynamics.systems import Link, Machine, Parameter, ParameterTable
from ocp import Problem, gradient_report, solve
from ocp.errors import InputError
from ocp.gradients.worlds.plans import along, compare_gradients, law_plan, mujoco_plan, plan_directions, plan_questions
from ocp.gradients.worlds.world import World
from ocp.problem.parts import Scenarios
from ocp.simulators.replay import replay_in_simulator
from problems import get

PUSHER = """
import numpy as np
M, K, h, width, goal = 1.0, {K}, 0.1, 0.2, 1.0
def rollout(theta):
    '''Costs of push-1d, whose steps have a closed form: the pusher is at its command, or moves with the object.'''
    object_x, before, cost = np.zeros(len(theta)), -0.5, 0.0
    for u in theta.T:
        cost = cost + (object_x - goal) ** 2 + 0.1 * (u - before) ** 2
        together = (M / h * object_x + h * K * (u + width)) / (M / h + h * K)
        object_x, before = np.where(u + width > object_x, together, object_x), u
    return (cost + 100 * (object_x - goal) ** 2)[:, None]
"""


def pusher(folder: Path, K: float) -> str:
    file = folder / f"pusher{K:.0f}.py"
    file.write_text(PUSHER.format(K=K))
    return str(file)


@pytest.mark.costly
def test_another_implementation_of_a_plan_is_right_and_that_of_a_softer_pusher_is_not(tmp_path: Path) -> None:
    plan = solve(get("push-1d", N=6), contact="exact", effort="quick")
    exact = law_plan(plan.problem, Exact(), plan.values).rollout(plan.data["u"].values.reshape(1, -1))
    assert exact[0, 0] == pytest.approx(plan.audit.exact_cost, rel=1e-8)
    report = gradient_report(plan, [pusher(tmp_path, 100.0), pusher(tmp_path, 10.0)], samples=100)
    right, soft = report.rows[::2], report.rows[1::2]
    assert {row["verdict"] for row in right} == {"right"}, report.sentences
    assert "right" not in {row["verdict"] for row in soft}, report.sentences
    numbers, other = (row["findings"][-1]["numbers"] for row in report.rows[:2])
    assert numbers["count"] == 6 and numbers["cosine"] > 0.98
    assert numbers["length"] == pytest.approx(numbers["truth"], rel=0.05) != pytest.approx(other["length"], rel=0.2)


@pytest.mark.costly_cases("law1")
@pytest.mark.parametrize("law", [Exact(), Barrier(mu=1e-3)])
def test_slopes_of_laws_are_those_of_differences(law) -> None:
    problem, rng = get("push-1d", N=6), np.random.default_rng(1)
    world = law_plan(problem, law, problem.parameters.defaults)
    inputs, rows = np.linspace(-0.4, 0.8, 6) + 0.05 * rng.normal(size=6), rng.normal(size=(2, 6))
    t, a = np.zeros((1, 2)), 1e-6
    line = along(world, inputs, rows)
    values = line.rollout(np.concatenate([t + a * np.eye(2), t - a * np.eye(2)]))[:, 0]
    np.testing.assert_allclose(line.gradient(t)[0, 0], (values[:2] - values[2:]) / (2 * a), rtol=1e-5)


def test_the_mean_over_scenarios_is_differentiated() -> None:
    """The mean over three starts is that of three problems with one start each, and so is its gradient."""
    problem = replace(get("push-1d", N=4), scenarios=Scenarios(3, (0.02, 0.1)))
    values, inputs, a = problem.parameters.defaults, np.array([[-0.1, 0.3, 0.7, 0.8]]), 1e-6
    world, starts = law_plan(problem, Exact(), values), problem.initial_states(problem.parameters.values)
    alone = [law_plan(replace(get("push-1d", N=4), x0=ca.SX(x0)), Exact(), values) for x0 in starts]
    np.testing.assert_allclose(world.rollout(inputs), np.mean([each.rollout(inputs) for each in alone], axis=0))
    np.testing.assert_allclose(world.gradient(inputs), np.mean([each.gradient(inputs) for each in alone], axis=0))
    costs = world.rollout(np.concatenate([inputs + a * np.eye(4), inputs - a * np.eye(4)]))[:, 0]
    np.testing.assert_allclose(world.gradient(inputs)[0, 0], (costs[:4] - costs[4:]) / (2 * a), rtol=1e-5, atol=1e-7)


def test_directions_have_the_size_of_inputs_and_the_first_is_the_gradient_except_at_an_optimum() -> None:
    optimum, sizes = np.array([1.0, -2.0, 0.5]), np.array([1.0, 10.0, 0.1])
    bowl = World(
        "bowl",
        lambda u: np.square((u - optimum) / sizes).sum(axis=1, keepdims=True),
        lambda u: (2 * (u - optimum) / sizes**2)[:, None],
    )
    beside = plan_directions(bowl, optimum + sizes, sizes, seed=3)
    assert [*beside] == ["g", "d2", "d3"] and [*plan_directions(bowl, optimum, sizes, seed=3)] == ["d1", "d2", "d3"]
    np.testing.assert_allclose(beside["g"], sizes)
    for direction in beside.values():
        assert np.square(direction / sizes).mean() == pytest.approx(1)
    halved = replace(bowl, simulate=lambda u: bowl.simulate(u) / 2, differentiate=None)
    for factor in (0.5, -0.5):
        halved = replace(bowl, simulate=lambda u, c=factor: c * bowl.simulate(u), differentiate=None)
        numbers = compare_gradients(halved, bowl, optimum + sizes, sizes, seed=0).numbers
        assert numbers["truth"] == pytest.approx(2 * np.sqrt(3), rel=0.03)
        assert numbers["length"] == pytest.approx(numbers["truth"] / 2)
        assert numbers["cosine"] == pytest.approx(2 * factor)


def slider(h: float, N: int) -> Problem:
    """Return the problem of a mass of 2 kg on a slide with a motor, whose cost is its last position."""
    p = ParameterTable([Parameter("h", h, "s")])
    mass = Link("mass", None, 2.0, 0.1, joint="slide", axis=(1.0, 0.0), gear=1.0)
    system = Machine((mass,), ()).system("slider", p, h=p["h"], friction=None)
    return Problem("slider", system, N, ca.SX(0), system.x[0], np.zeros(2), p)


def test_mujoco_differentiates_forces_on_a_free_mass() -> None:
    """A force over [k h, (k + 1) h] in steps s moves a mass m by ``(N - 1 - k) h^2/m + h (h + s)/(2 m)``."""
    pytest.importorskip("mujoco")
    h, N, m = 0.02, 5, 2.0
    problem = slider(h, N)
    world = mujoco_plan(problem, problem.parameters.defaults)
    later = (N - 1 - np.arange(N)) * h**2 / m
    slopes = along(world, np.zeros(N), np.eye(N)).rollout(np.eye(N))[:, 0]
    np.testing.assert_allclose(slopes, later + h * (h + world.settings["step"]) / (2 * m), rtol=1e-6)
    exact = law_plan(problem, Exact(), problem.parameters.defaults)
    np.testing.assert_allclose(exact.gradient(np.zeros((1, N)))[0, 0], later + h**2 / m, rtol=1e-9)


def test_costs_in_mujoco_are_those_of_the_replay() -> None:
    pytest.importorskip("mujoco")
    problem = get("finger-disc", h=0.02, N=3)
    values = problem.parameters.defaults
    inputs = np.random.default_rng(0).normal(size=(2, 3, problem.system.nu))
    costs = mujoco_plan(problem, values).rollout(inputs.reshape(2, -1))[:, 0]
    x0 = problem.initial_states(problem.parameters.values)
    replays = [replay_in_simulator("mujoco", problem, u[None], values, x0, 1.0).cost for u in inputs]
    np.testing.assert_allclose(costs, replays, rtol=1e-12)


def test_plans_that_cannot_be_judged_get_one_sentence() -> None:
    problem = get("push-1d", N=6)
    values, x0 = problem.parameters.defaults, problem.initial_states(problem.parameters.values)

    def ask(x0: np.ndarray, u: np.ndarray, world: str = "exact") -> None:
        arrays = {"x": SimpleNamespace(values=x0[:, None]), "u": SimpleNamespace(values=u)}
        plan: Any = SimpleNamespace(problem=problem, values=values, data=arrays)
        plan_questions(plan, [world], lambda path: pytest.fail(path), 0)

    u = np.zeros((1, 6, 1))
    ask(x0, u)
    with pytest.raises(InputError, match=r"unknown world 'mujco'.*did you mean 'mujoco'"):
        ask(x0, u, "mujco")
    with pytest.raises(InputError, match="have different inputs"):
        ask(x0, np.concatenate([u, u + 1]))
    with pytest.raises(InputError, match="chooses its own start"):
        ask(x0 + 1, u)
