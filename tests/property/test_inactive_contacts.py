"""Under the exact law a contact that is open contributes nothing to a derivative, to the last bit."""

from __future__ import annotations

from functools import cache

import casadi as ca
import numpy as np
import pytest

import problems
from dynamics.batch import StepFunction
from dynamics.contact import Exact, Step
from ocp import Feedback
from ocp.gradients.rollouts import RolloutObjective
from tests.unit.dynamics.batch.backends import BACKENDS

FORWARD = {
    "push-1d": {"qa": 0.0},
    "hopper-1d": {"zb": 1.0, "zf": 1.0},
    "hopper": {"torso_z": 1.0},
    "half-cheetah": {"torso_z": 1.0},
    "soft-walls": {"p": -0.4},
    "finger-disc": {"shoulder": -0.5},
    "idto-hopper": {"torso_z": 1.0},
}
"""Additions to a problem's initial state, with which all contacts are open after a step."""
FOLLOWED = {
    "push-1d": ["qa"],
    "push-disc": ["ax", "ay"],
    "planar-push": ["ax", "ay"],
    "planar-hand": ["l1", "l2", "r1", "r2"],
}
"""States that a problem's inputs command; other problems have zero inputs."""
MACHINES = {"hopper", "half-cheetah", "spinner", "finger-disc", "idto-hopper"}
LONG = {*MACHINES, "planar-hand"}
"""Problems that take too long to compile in the default tests, which use the other engines."""
SPACE = ("quadruped", "ant", "push-cube", "reorient")
"""Problems that start in contact in every coordinate; tests/unit/dynamics/space tests their free motion."""
NAMES = [name for name in problems.names() if name not in SPACE]
ENGINES = [
    pytest.param(name, backend, marks=[pytest.mark.slow] * (backend == "c" and name in LONG))
    for name in NAMES
    for backend in BACKENDS
]


@cache
def closed(name: str) -> Step:
    return Exact().close(problems.get(name).system)


def apart(name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return a state from which a step makes no contact, and its input."""
    problem = problems.get(name)
    states = [signal.name for signal in problem.system.states]
    x = problem.initial_states(problem.parameters.values)[0].copy()
    for entry, shift in FORWARD.get(name, {}).items():
        x[states.index(entry)] += shift
    u = [x[states.index(entry)] for entry in FOLLOWED.get(name, [])]
    return x, np.array(u or [0.0] * problem.system.nu)


@pytest.mark.cheap_cases(
    "wall-1d", "push-1d", "push-disc", "ball-bounce", "cart-walls", "box-slide", "ball-throw", "cart-transport"
)
@pytest.mark.parametrize("name", NAMES)
def test_impulses_that_do_not_act_have_no_derivative(name):
    """It is zero by the state, the input and every parameter, though a machine's slip is undetermined."""
    step, (x, u) = closed(name), apart(name)
    arguments = [ca.MX.sym("x", len(x)), ca.MX.sym("u", len(u)), ca.MX.sym("p", len(step.p))]
    after, lam = step.map(*arguments)
    every = ca.vertcat(*arguments)
    results = [lam, ca.jacobian(lam, every), ca.jacobian(after, every)]
    slopes = ca.Function("slopes", arguments, results)
    found, by_all, moved = (np.array(part) for part in slopes(x, u, step.p.values))
    pushing = [i for i, pair in enumerate(step.system.pairs) if name not in MACHINES or pair.kind != "slip"]
    assert np.all(found[pushing] == 0.0)
    assert np.all(by_all == 0.0) and np.all(np.isfinite(moved))


@pytest.mark.costly_cases("cart-walls-c", "hopper-1d-c", "push-t-c")
@pytest.mark.one_case_in(6)
@pytest.mark.parametrize(("name", "backend"), ENGINES)
def test_a_step_without_contact_has_the_derivative_of_free_motion(name, backend):
    """Zeros agree to the bit, except for machines, whose mass matrix is eliminated twice."""
    step, (x, u) = closed(name), apart(name)
    system = step.system
    free = ca.substitute(system.x_next_expr, system.lam, ca.SX.zeros(system.nlam))
    arguments = [system.x, system.u]
    results = [ca.jacobian(free, w) for w in arguments]
    slopes = ca.Function("free", [*arguments, system.parameters.vector], results)
    expected = slopes(x, u, step.p.values)
    _, *found = StepFunction(step, backend, threads=1).derivatives(x, u)
    for one, other in zip(found, expected, strict=True):
        one, other = one[0], np.array(other)
        assert np.allclose(one, other, rtol=0, atol=1e-12 * (1 + np.abs(other).max()))
        if name not in MACHINES:
            assert np.all(one[other == 0.0] == 0.0)


@pytest.mark.costly_cases("planar-hand-numpy", "planar-hand-casadi")
@pytest.mark.parametrize(("name", "backend"), [e for e in ENGINES if "planar" in e.values[0]])
def test_the_object_has_no_gradient_from_a_start_without_contact(name, backend):
    """In a plan of two steps from rest the actuators do not reach the object."""
    problem = problems.get(name, N=2, w_a=0.0, w_du=0.0)
    objective = RolloutObjective(problem, Exact(), Feedback(), backend=backend, threads=1)
    cost, gradient = objective.cost_and_gradient(objective.theta)
    assert cost > 1
    assert np.all(gradient == 0.0)


@pytest.mark.costly_cases("planar-hand")
@pytest.mark.parametrize("name", ["planar-push", "planar-hand"])
def test_at_contact_the_derivative_is_that_of_the_active_set(name):
    """It is that of motion and active gaps, linearised and solved without a path.

    Active pairs are at the path's end, so that their rows have ``gap / lam`` on the diagonal,
    which changes the solution by at most ``|inverse| |solution| max(gap / lam)``.
    """
    step = closed(name)
    system, p = step.system, step.p.values
    unknown, given = ca.vertcat(system.x_next, system.lam), ca.vertcat(system.x, system.u)
    relation = ca.vertcat(system.residual, system.gap)
    symbols = [system.x, system.u, system.x_next, system.lam, system.parameters.vector]
    results = [system.gap, ca.jacobian(relation, unknown), ca.jacobian(relation, given)]
    linear = ca.Function("linear", symbols, results)
    rng, n = np.random.default_rng(3), 80
    x = apart(name)[0] + 0.05 * rng.normal(size=(n, system.nx))
    u = x[:, -system.nu :] + 0.2 * rng.normal(size=(n, system.nu))
    steps, by_x, by_u = StepFunction(step, "numpy", threads=1).derivatives(x, u)
    tried = 0
    for k, (after, lam) in enumerate(zip(steps.x_next, steps.lam, strict=True)):
        gap, by_unknown, by_given = (np.array(v) for v in linear(x[k], u[k], after, lam, p))
        active = lam > gap[:, 0]
        if not active.any():
            continue
        kept = np.concatenate([np.full(system.nx, True), active])
        inverse = np.linalg.inv(by_unknown[kept][:, kept])
        expected = -inverse @ by_given[kept]
        weak = np.linalg.norm(inverse, 2) * np.max(np.abs(gap[active, 0]) / lam[active])
        if weak * np.linalg.norm(expected, 2) > 1e-9:
            continue
        found = np.concatenate([by_x[k], by_u[k]], axis=1)
        assert np.allclose(found, expected[: system.nx], rtol=0, atol=1e-9)
        assert np.all(lam[~active] == 0.0)
        tried += 1
    assert tried > 5
