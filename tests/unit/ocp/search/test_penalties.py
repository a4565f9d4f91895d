"""Penalties of samples for constraints that rollouts do not have, and the states that they are computed from."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from dynamics.batch import open_loop
from ocp.problem.batch_rollouts import batch_rollouts
from ocp.problem.evaluation import Evaluation
from ocp.problem.parts import Constraint
from ocp.problem.problem import DEPTH, SHARES, Problem
from ocp.problem.rollout import roll_out
from ocp.search.penalties import FREE_SHARE, PENALTY_WEIGHT, TransitionPenalty, penalized
from ocp.search.sampling import InputSampler
from problems import get
from tests.benchmarks.found.problems import STRANGERS


def evaluation(problem: Problem) -> Evaluation:
    return Evaluation(problem, problem.parameters.defaults)


def inputs_of(problem: Problem, n: int) -> np.ndarray:
    """Return random inputs (n, N, nu) near the guess."""
    guess = evaluation(problem).initial_guess[1]
    noise = np.random.default_rng(0).standard_normal((n, *guess.shape))
    return guess + 0.3 * problem.scales.u * noise


@pytest.mark.parametrize("backend", ["numpy", "auto"])
@pytest.mark.parametrize("name", ["wall-1d", "push-disc"])
def test_states_of_rollouts_are_those_of_single_rollouts(name, backend) -> None:
    problem = get(name, N=5)
    at_values = evaluation(problem)
    system, step = problem.system, problem.exact_step
    function = batch_rollouts(problem, step, open_loop(system.nx, system.nu), backend=backend)
    inputs, before = inputs_of(problem, 3), at_values.limits.u_before if problem.uses_du else None
    p, x0 = step.p.pack(at_values.values), at_values.initial_states[0]
    rollouts = function(x0, inputs, p, n_samples=3, gradient=False, states=True, u_before=before)
    assert rollouts.states is not None
    for states, sample in zip(rollouts.states, inputs, strict=True):
        single = roll_out(problem, sample[None], problem.parameters.defaults)
        np.testing.assert_allclose(states, single.x[0], rtol=1e-7, atol=1e-9)
    assert function(x0, inputs, p, n_samples=3, gradient=False, u_before=before).states is None


def test_a_constraint_on_the_next_state_costs_its_violation() -> None:
    problem = get("wall-1d", N=5)
    position, limit = problem.system.x_next[0], 0.05
    limited = replace(problem, path=(*problem.path, Constraint("near", position, -ca.inf, limit)))
    inputs = inputs_of(problem, 1)[0] + problem.scales.u
    x = roll_out(problem, inputs[None], problem.parameters.defaults).x[0]
    excess = np.maximum((x[1:, 0] - limit) / problem.scales.x[0] - FREE_SHARE, 0).sum()
    assert excess > 0
    plain, bounded = (InputSampler(evaluation(each)).exact_cost(inputs) for each in (problem, limited))
    assert bounded - plain == pytest.approx(PENALTY_WEIGHT * problem.scales.cost * excess, rel=1e-6)


def test_rows_on_impulses_and_problems_without_rows_have_no_penalty() -> None:
    problem = get("wall-1d", N=5)
    pulling = Constraint("impulse", problem.system.lam[0] + problem.system.x_next[0], -ca.inf, 0.0)
    assert TransitionPenalty.of_problem(evaluation(problem)) is None
    assert TransitionPenalty.of_problem(evaluation(replace(problem, path=(*problem.path, pulling)))) is None
    assert penalized(problem).path == ()


def test_a_finger_that_jumps_through_a_body_pays_for_its_depth() -> None:
    problem = get(str(STRANGERS / "plans" / "ell_post.py"))
    at_values = evaluation(problem)
    penalty = TransitionPenalty.of_problem(at_values)
    assert penalty is not None and problem.signed_distance is not None
    states = np.repeat(at_values.initial_states[0][None, None], 2, axis=1).repeat(2, axis=0)
    for sample, x_next in ((0, 0.15), (1, -0.9)):
        states[sample, 0, -2:], states[sample, 1, -2:] = (-0.2, -0.05), (x_next, -0.05)
    states[1, 0, -2:] = (-1.0, -0.05)
    between = (states[0, 0] + share * (states[0, 1] - states[0, 0]) for share in SHARES)
    gaps = np.array([problem.signed_distance(state, at_values.p).full().ravel() for state in between])
    excess = np.maximum((-DEPTH * problem.scales.gap - gaps) / problem.scales.gap - FREE_SHARE, 0).sum()
    assert excess > 0
    expected = [PENALTY_WEIGHT * problem.scales.cost * excess, 0.0]
    np.testing.assert_allclose(penalty(states, np.zeros((2, 1, problem.system.nu))), expected, rtol=1e-9)


def test_sampling_around_a_plan_lowers_its_cost_by_the_same_bits_again() -> None:
    problem = get("wall-1d", N=20)
    at_values = evaluation(problem)
    worse = np.zeros((problem.N, problem.system.nu))
    around, again = (InputSampler(at_values, seed=2).around(worse, 5) for _ in range(2))
    assert around.cost < InputSampler(at_values).exact_cost(worse)
    assert np.array_equal(around.inputs, again.inputs)
    exact = roll_out(problem, around.inputs[None], problem.parameters.defaults).cost
    assert exact == pytest.approx(around.cost, rel=1e-9)
