"""Penetration and violated constraints of trajectories, by closed forms and dense samples."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from ocp import Constraint, Problem
from ocp.judge.constraints import broken_constraints
from ocp.judge.measures import least_between, measure
from problems import get
from tests.unit.ocp.user_problems import at_defaults, physical, trajectories


def test_a_fast_disc_does_not_pass_through_another_unnoticed() -> None:
    """Both nodes are a metre away; the smallest distance is where the straight path passes the centre."""
    problem = get("push-disc", N=2)
    x = np.array([[[0.0, 0, -1.0, 0.2], [0.0, 0, 1.1, 0.2], [0.0, 0, 1.1, 0.2]]])
    rolled = trajectories(x, np.zeros((1, 2, 2)), np.zeros((1, 2, 1)))
    found = measure(at_defaults(problem), problem.exact_step, rolled)
    assert found.penetration is not None
    assert found.between is not None
    assert found.penetration.amount == 0.0
    assert found.between.amount == pytest.approx(0.6 - 0.2, rel=1e-9)
    assert (found.between.contact, found.between.step) == ("push", 0)


def test_distances_between_nodes_of_discs_are_exact() -> None:
    problem = get("push-disc")
    x = np.random.default_rng(3).normal(scale=2.0, size=(4, 51, 4))
    apart = x[..., :2] - x[..., 2:]
    start, way = apart[:, :-1], np.diff(apart, axis=1)
    share = np.clip(-(start * way).sum(-1) / (way**2).sum(-1), 0, 1)
    exact = np.linalg.norm(start + share[..., None] * way, axis=-1) - 0.6
    found = least_between(at_defaults(problem), x)[..., 0]
    np.testing.assert_allclose(found, exact, atol=1e-8)


def test_distances_between_nodes_of_a_turning_box_are_those_of_dense_samples() -> None:
    problem = get("planar-push")
    x = np.random.default_rng(4).normal(scale=0.6, size=(1, 21, 5))
    share = np.linspace(0, 1, 4001)[:, None]
    dense = x[:, :-1, None] + share * np.diff(x, axis=1)[:, :, None]
    phi = at_defaults(problem).signed_distances(dense)
    assert phi is not None
    least = phi.min(axis=2)
    found = least_between(at_defaults(problem), x)
    np.testing.assert_allclose(found, least, atol=2e-3)


# --- constraints of the replay ---------------------------------------------------------------


def no_impulses(problem: Problem) -> np.ndarray:
    return np.zeros((1, problem.N, problem.system.nlam))


def test_broken_constraints_are_named_with_step_and_amount() -> None:
    problem = get("planar-hand")
    p = physical(problem)
    x = np.repeat(problem.initial_states(p)[:, None], problem.N + 1, axis=1)
    u = x[:, :-1, 3:].copy()
    assert broken_constraints(at_defaults(problem), trajectories(x, u, no_impulses(problem))) == []
    x_upper = np.array(problem.limits(p)[5]).ravel()
    x[0, 12, 4] = x_upper[4] + 0.2
    u[0, 12, 1] = x[0, 12, 4]
    u[0, 5, 0] += float(get("planar-hand").parameters.get("reach").value) + 0.05
    first, second = broken_constraints(at_defaults(problem), trajectories(x, u, no_impulses(problem)))[:2]
    assert (first.violation.name, first.violation.component) == ("bound on x", "l2")
    assert (first.violation.step, first.violation.amount) == (12, pytest.approx(0.2))
    assert first.share == pytest.approx(0.2 / problem.scaling.x)
    assert (second.violation.component, second.violation.step) == ("reach[0]", 5)
    assert second.violation.amount == pytest.approx(0.05)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_the_share_of_a_constraint_does_not_depend_on_how_it_is_written(scale: float) -> None:
    problem = get("push-1d")
    end = Constraint("end", scale * problem.system.x[0], scale * 0.3, ca.inf)
    problem = replace(problem, terminal=[end])
    x = np.zeros((1, problem.N + 1, 2))
    found = broken_constraints(at_defaults(problem), trajectories(x, np.zeros((1, problem.N, 1)), no_impulses(problem)))
    assert len(found) == 1
    assert found[0].violation.name == "terminal"
    assert found[0].violation.step == problem.N
    assert found[0].violation.amount == pytest.approx(0.3 * scale)
    assert found[0].share == pytest.approx(0.3 / problem.scaling.x)


def test_a_broken_period_of_a_chosen_start_is_named() -> None:
    problem = get("half-cheetah", N=4)
    p = physical(problem)
    x = np.repeat(problem.initial_states(p)[:, None], 5, axis=1)
    x[0, :, 0] = np.linspace(0, 4 * x[0, 0, -1], 5)
    u = np.zeros((1, 4, 6))
    assert broken_constraints(at_defaults(problem), trajectories(x, u, no_impulses(problem))) == []
    x[0, -1, 12] += 1.5
    (found,) = broken_constraints(at_defaults(problem), trajectories(x, u, no_impulses(problem)))
    names = [signal.name for signal in problem.system.states]
    assert (found.violation.name, found.violation.component) == ("periodic", names[12])
    assert (found.violation.step, found.violation.amount) == (4, pytest.approx(1.5))
