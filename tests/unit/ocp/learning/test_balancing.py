"""Initial policies that balance an unstable pendulum, whose contact is far away."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from dynamics.systems import Signal, lcs
from ocp.errors import InputError
from ocp.learning.experiment import EXACT
from ocp.learning.protocol import balancing_feedback
from ocp.learning.training import evaluate
from ocp.learning.unroll_gradients import FOPG
from ocp.problem.task import Task
from tests.unit.ocp.learning.scalar import experiment

A = np.array([[1.0, 0.1, 0.0], [0.3, 1.0, 0.0], [0.0, 0.1, 1.0]])
B = np.array([[0.0], [0.2], [0.1]])
HALF = 3.0


def pendulum(observed: slice = slice(0, 2), offset: float = 0.0) -> Task:
    """Return a task of balancing a pendulum: angle, rate, and a third state that is not observed by default."""
    system = lcs(
        "pendulum",
        A=A,
        B=B,
        C=np.zeros((3, 1)),
        D=np.zeros((1, 3)),
        E=[[0.0]],
        F=[[1.0]],
        c=[0.0, offset, 0.0],
        d=[1.0],
    )
    x, chance = system.x, ca.SX.sym("chance", 2)
    return Task(
        name="pendulum",
        system=system,
        parameters=system.parameters,
        horizon=60,
        start=ca.vertcat(0.05 * chance, 0),
        chance=chance,
        reward=ca.SX(1),
        observation=2 * x[observed],
        observations=tuple(Signal(f"o{i}", "1") for i in range(*observed.indices(3))),
        lower=np.array([-HALF]),
        upper=np.array([HALF]),
        done=ca.fabs(x[0]) > 0.5,
    )


def test_the_feedback_is_that_of_the_riccati_equation():
    """The Riccati equation is that of the first two states; observations are twice the states."""
    W, b = balancing_feedback(pendulum(), np.zeros(3))
    fall, push = A[:2, :2], HALF * B[:2]
    P = solve_discrete_are(fall, push, 4e-3 * np.eye(2), np.eye(1))
    K = np.linalg.solve(1 + push.T @ P @ push, push.T @ P @ fall)
    assert pytest.approx(-K / 2, rel=1e-6) == W
    assert b == pytest.approx([0.0])


@pytest.mark.parametrize("hidden", [(), (8,), (16, 4)])
def test_policies_begin_by_balancing(hidden):
    """Policies with any layers balance from the start if ``rest`` is given; random ones fall."""
    for rest, expected in (((0.0, 0.0, 2.0), True), (None, False)):
        e = experiment(FOPG(), task=pendulum(), hidden=hidden, rest=rest, seed=1)
        found = evaluate(e, e.algorithm.policy(e, e.algorithm.begin(e)), EXACT, 8)
        assert (found.lengths == 60).all() == expected
        if rest is not None:
            assert np.abs(found.states[:, -1, :2]).max() < 0.01


def test_layers_change_the_feedback_little():
    policies = []
    for hidden in ((), (16, 4)):
        e = experiment(FOPG(), task=pendulum(), hidden=hidden, rest=(0.0, 0.0, 0.0))
        x = np.random.default_rng(0).uniform(-0.1, 0.1, (20, 3))
        policies.append(e.inputs(e.algorithm.policy(e, e.algorithm.begin(e)), x))
    assert policies[1] == pytest.approx(policies[0], abs=2e-3 * HALF)
    assert np.abs(policies[0]).max() > 0.1


@pytest.mark.parametrize(
    ("task", "rest", "hidden", "words"),
    [
        (pendulum(), (0.0, 0.0), (), r"rest must be 3 finite numbers, a state of pendulum, got"),
        (pendulum(), (0.0, np.nan, 0.0), (), "rest must be 3 finite numbers"),
        (pendulum(), (0.2, 0.0, 0.0), (), "pendulum does not rest at the state given: a step mo"),
        (pendulum(offset=0.1), (0.0,) * 3, (), "does not rest at the state given"),
        (
            pendulum(slice(0, 1)),
            (0.0,) * 3,
            (),
            "cannot be stabilised at rest from its observations",
        ),
    ],
)
def test_what_cannot_balance_is_told(task, rest, hidden, words):
    e = experiment(FOPG(), task=task, hidden=hidden, rest=rest)
    with pytest.raises(InputError, match=words):
        e.algorithm.begin(e)


def test_layers_too_narrow_for_the_inputs_are_told():
    task = pendulum()
    both = lcs(
        "pendulum",
        A=A,
        B=np.hstack([B, B]),
        C=np.zeros((3, 1)),
        D=np.zeros((1, 3)),
        E=np.zeros((1, 2)),
        F=[[1.0]],
        d=[1.0],
    )
    x = both.x
    task = replace(
        task,
        system=both,
        observation=2 * x[:2],
        done=ca.fabs(x[0]) > 0.5,
        lower=-np.ones(2),
        upper=np.ones(2),
    )
    e = experiment(FOPG(), task=task, hidden=(1,), rest=(0.0, 0.0, 0.0))
    with pytest.raises(InputError, match="needs hidden layers of at least 2 units"):
        e.algorithm.begin(e)
