"""Collected transitions: exact steps from states without penetration, half of them in the tube."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import dynamics.batch.function as stepping
from dynamics.learned.collecting import collect_transitions
from dynamics.learned.region import Region
from dynamics.learned.transitions import Transitions
from ocp.problem.problem import Problem
from problems import get
from problems.regions import around_task, region_of
from problems.registry import spec

DECLARED = ["push-1d", "push-disc", "planar-push", "planar-hand"]
DEFAULT = ["wall-1d", "box-slide", "hopper-1d"]


@cache
def problem(name: str) -> Problem:
    return get(name)


@cache
def region(name: str) -> Region:
    return region_of(spec(name), spec(name).params({}), problem(name))


@cache
def data(name: str) -> Transitions:
    return collect_transitions(problem(name).exact_step, region(name), 601, seed=5)


@pytest.mark.cheap_cases("box-slide", "push-1d", "push-disc", "planar-push")
@pytest.mark.parametrize("name", [*DECLARED, *DEFAULT])
def test_next_states_are_those_of_the_exact_step(name: str) -> None:
    found, step = data(name), problem(name).exact_step
    solved = step.solve.map(len(found))(found.x.T, found.u.T, np.tile(step.p.values, (601, 1)).T)
    x_next, error = np.array(solved[0]).T, np.array(solved[3])
    assert len(found) == 601 and error.max() < 1e-7
    np.testing.assert_allclose(found.x_next, x_next, rtol=0, atol=1e-9)
    # Some transitions have contact: without an impulse the object would not move.
    assert (np.array(solved[1]).max(axis=0) > 1e-6).mean() > 0.02


@pytest.mark.costly_cases("planar-hand")
@pytest.mark.parametrize("name", [*DECLARED, "wall-1d", "hopper-1d"])
def test_nothing_penetrates(name: str) -> None:
    distance = problem(name).signed_distance
    assert distance is not None
    p = problem(name).parameters.values
    phi = np.array(distance(data(name).x.T, np.tile(p, (601, 1)).T))
    assert phi.min() > -1e-14 and phi.min() < 0.05


@pytest.mark.costly_cases("planar-hand")
@pytest.mark.parametrize("name", DECLARED)
def test_half_is_in_the_tube_and_half_in_the_ranges(name: str) -> None:
    found, where = data(name), region(name)
    wide, tube = found.x[:301], found.x[301:]
    low, high = np.array([where.states[s.name] for s in found.states]).T
    assert ((wide >= low) & (wide <= high)).all()
    start, way = np.asarray(where.start), np.asarray(where.goal) - np.asarray(where.start)
    spread = np.asarray(where.spread)
    # The nearest point of the line in units of the noise: chi-square with nx - 1 degrees or fewer.
    scaled, along = (tube - start) / spread, way / spread
    t = np.clip(scaled @ along / (along @ along), 0, 1)
    off = np.linalg.norm(scaled - t[:, None] * along, axis=1)
    assert off.max() < 6 and t.min() < 0.2 and t.max() > 0.8
    assert found.provenance["in_tube"] == 300 and found.provenance["unsolved"] == 0


def test_inputs_are_measured_from_the_actuated_states() -> None:
    found = data("planar-push")
    reach = found.u - found.x[:, 3:]
    assert np.abs(reach).max() <= 0.2 and np.abs(reach).max() > 0.19
    plain = data("wall-1d")
    assert np.abs(plain.u).max() <= 1.0


@pytest.mark.costly
def test_the_seed_decides_and_threads_do_not(monkeypatch: pytest.MonkeyPatch) -> None:
    step = problem("planar-push").exact_step
    first, other = (collect_transitions(step, region("planar-push"), 3000, seed) for seed in (1, 2))
    assert first.hash != other.hash
    monkeypatch.setattr(stepping, "checked_threads", lambda threads: 3)
    assert collect_transitions(step, region("planar-push"), 3000, 1).hash == first.hash
    monkeypatch.setattr(stepping, "checked_threads", lambda threads: 1)
    assert collect_transitions(step, region("planar-push"), 3000, 1).hash == first.hash


def test_values_of_parameters_reach_step_and_distance() -> None:
    step = get("push-1d", width=0.6, M=3.0, qu0=1.0).exact_step
    found = collect_transitions(step, region("push-1d"), 400, 0)
    assert (found.x[:, 0] - found.x[:, 1]).min() >= 0.6
    rho = 1.0 / (3.0 + 1.0)
    wanted = found.x[:, 0] + rho * np.maximum(0, found.u[:, 0] - found.x[:, 0] + 0.6)
    np.testing.assert_allclose(found.x_next[:, 0], wanted, rtol=0, atol=1e-12)


def test_a_region_that_lies_inside_a_body_is_told() -> None:
    inside = replace(region("push-1d"), states={"qu": (-2.0, -1.0), "qa": (0.0, 1.0)})
    with pytest.raises(ValueError, match=r"only 0 of .* of the region could be used; choose"):
        collect_transitions(problem("push-1d").exact_step, inside, 50, 0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"states": {"q": (0.0, 1.0)}}, "range for states q, and push-1d has qu, qa"),
        ({"inputs": {"u": (1.0, 0.0)}}, r"input u must be finite and rise, got \[1, 0\]"),
        ({"inputs": {"u": (0.0, np.inf)}}, "input u must be finite and rise"),
        ({"around": {"u": "q"}}, "measures u: q; expected an input of u from a state of qu, qa"),
        ({"goal": (1.0,)}, "the region's goal must be 2 finite numbers"),
    ],
)
def test_a_region_that_does_not_fit_is_told(change: dict[str, object], message: str) -> None:
    wrong = replace(region("push-1d"), **change)
    with pytest.raises(ValueError, match=message):
        collect_transitions(problem("push-1d").exact_step, wrong, 50, 0)


def test_a_region_around_the_task_holds_start_goal_and_guess() -> None:
    found, task = around_task(problem("wall-1d")), problem("wall-1d")
    # The terminal cost is quadratic about x = goal_x = -0.5 and leaves the speed open.
    np.testing.assert_allclose(found.start, [1.0, 0.0])
    np.testing.assert_allclose(found.goal, [-0.5, 0.0], atol=1e-12)
    widths = task.scales.x
    np.testing.assert_allclose(found.states["x"], [-0.5 - widths[0], 1.0 + widths[0]])
    assert found.inputs["u"] == (-1.0, 1.0)


def test_a_state_that_no_step_changes_has_what_its_start_may_be() -> None:
    """The step size of half-cheetah is a state, and would become negative if drawn around its start."""
    chosen = get("half-cheetah")
    where = around_task(chosen)
    low, high = (np.array(v).ravel() for v in chosen.start_limits(chosen.parameters.values))
    names = [signal.name for signal in chosen.system.states]
    at = names.index("h")
    assert where.states["h"] == (low[at], high[at]) and low[at] > 0
    assert where.goal[at] == where.start[at] and where.spread[at] == 0
    assert where.states["v_torso_x"][0] < where.start[names.index("v_torso_x")]
