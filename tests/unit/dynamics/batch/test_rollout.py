"""Rollouts: agreement with CasADi and with differences, reproducible bits, and messages on bad input."""

from __future__ import annotations

import functools

import casadi as ca
import numpy as np
import pytest

from dynamics.batch import Gaussian, RolloutFunction, affine_policy, open_loop
from dynamics.batch.graphs import inner
from dynamics.batch.graphs.policy import RolloutPolicy
from dynamics.contact import Adaptive, Barrier, Exact, Randomized
from tests.unit.dynamics.batch.backends import BACKENDS, FAST
from tests.unit.dynamics.batch.rollout_cases import closed, four_contacts, reference, wall

SYSTEMS = {"wall": wall, "four": four_contacts}
LAWS = {
    "barrier": lambda: Barrier(mu=1e-3),
    "exact": Exact,
    "adaptive": lambda: Adaptive(sigma=0.1),
    "randomized": lambda: Randomized(sigma=0.1),
}
POLICIES = {
    "open": open_loop,
    "affine": affine_policy,
    "affine-per-step": functools.partial(affine_policy, per_step=True),
}
HORIZON = 6


@functools.cache
def case(system: str, law: str):
    return closed(SYSTEMS[system](), LAWS[law]())


@functools.cache
def rollout(system: str, law: str, policy: str, backend: str = "c", **options) -> RolloutFunction:
    step, *costs = case(system, law)
    chosen = POLICIES[policy](step.system.nx, step.system.nu)
    return RolloutFunction(step, *costs, HORIZON, chosen, backend=backend, **options)


def inputs(f: RolloutFunction, n: int) -> dict[str, np.ndarray]:
    return inputs_of(f, f.tapes.nx, n)


def inputs_of(f: RolloutFunction, nx: int, n: int) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    return {
        "x0": rng.standard_normal((n, nx)),
        "theta": 0.3 * rng.standard_normal((n, *f.policy.shape(HORIZON))),
        "noise": 0.1 * rng.standard_normal((n, HORIZON, f.tapes.nu)),
    }


@pytest.mark.costly_cases("wall-randomized-affine-c", "four-barrier-affine-numpy", "four-adaptive-affine-per-step-c")
@pytest.mark.one_case_in(10)
@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("policy", list(POLICIES))
@pytest.mark.parametrize("law", list(LAWS))
@pytest.mark.parametrize("system", list(SYSTEMS))
def test_cost_and_gradient_are_those_of_the_unrolled_graph(system, law, policy, backend):
    if law == "randomized" and system == "four" and backend != "c":
        pytest.skip("many branches of an inner loop: the compiled one stands for all")
    f = rollout(system, law, policy, backend)
    step, *costs = case(system, law)
    wanted = reference(step, *costs, HORIZON, f.policy)
    given = inputs(f, 5)
    got = f(**given)
    for i in range(5):
        theta = np.atleast_2d(given["theta"][i]).T
        cost, gradient = wanted(given["x0"][i], theta, step.p.values, given["noise"][i].T)
        np.testing.assert_allclose(got.cost[i], float(cost), rtol=1e-12)
        scale = np.abs(gradient).max()
        np.testing.assert_allclose(np.atleast_2d(got.gradient[i]).T, np.array(gradient), rtol=1e-9, atol=1e-11 * scale)


@pytest.mark.cheap_cases("adaptive-c")
@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("law", ["barrier", "adaptive"])
def test_gradient_is_that_of_central_differences(law, backend):
    f = rollout("four", law, "affine", backend)
    given = inputs(f, 3)
    gradient, h = f(**given).gradient, 1e-6
    for k in range(gradient.shape[1]):
        ahead, behind = (given["theta"].copy() for _ in range(2))
        ahead[:, k] += h
        behind[:, k] -= h
        costs = [f(**{**given, "theta": t}, gradient=False).cost for t in (ahead, behind)]
        slope = (costs[0] - costs[1]) / (2 * h)
        np.testing.assert_allclose(gradient[:, k], slope, rtol=1e-6, atol=1e-6)


def test_frozen_gradient_leaves_out_the_change_of_mu():
    answers = {}
    for kind in ("total", "frozen"):
        step, *costs = closed(wall(), Adaptive(sigma=0.1, gradient=kind))
        f = RolloutFunction(step, *costs, HORIZON, open_loop(2, 1))
        given = inputs(f, 4)
        answers[kind] = f(**given)
        wanted = reference(step, *costs, HORIZON, f.policy)
        exact = [
            wanted(x, t.T, step.p.values, w.T)[1]
            for x, t, w in zip(given["x0"], given["theta"], given["noise"], strict=True)
        ]
        np.testing.assert_allclose(answers[kind].gradient[:, :, 0], np.array(exact)[:, 0], rtol=1e-9)
    np.testing.assert_array_equal(answers["total"].cost, answers["frozen"].cost)
    assert np.abs(answers["total"].gradient - answers["frozen"].gradient).max() > 1e-3


@pytest.mark.costly_cases("four-c", "four-numpy")
@pytest.mark.parametrize("backend", FAST)
@pytest.mark.parametrize("system", list(SYSTEMS))
def test_threads_and_blocks_do_not_change_a_bit(system, backend):
    answers = []
    for threads in (1, 2):
        for block in (8, 64):
            f = rollout(system, "barrier", "affine", backend, threads=threads, block=block)
            noise = Gaussian(0.1, seed=5)
            n = 5000 if system == "wall" or backend != "numpy" else 500
            given = inputs(f, n) | {"noise": noise}
            values = f(**given, score=True)
            moments = f.moments(**given, score=True, baseline=0.3)
            arrays = [values.cost, values.gradient, values.score]
            for m in (moments.value, moments.gradient, moments.zeroth):
                arrays += [m.mean, m.m2]
            answers.append(arrays)
    for answer in answers[1:]:
        for one, other in zip(answers[0], answer, strict=True):
            np.testing.assert_array_equal(one, other)


@pytest.mark.cheap_cases("barrier-c")
@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("law", ["barrier", "exact"])
def test_path_takes_over_where_newton_does_not_come_to_rest(law, backend, monkeypatch):
    newton = rollout("four", law, "open", backend)
    monkeypatch.setattr(inner, "NEWTON_ITERATIONS", 0)
    path = RolloutFunction(*case("four", law), HORIZON, newton.policy, backend=backend)
    given = inputs(newton, 33)
    got = path(**given)
    monkeypatch.undo()
    wanted = newton(**given)
    np.testing.assert_allclose(got.cost, wanted.cost, rtol=1e-12)
    scale = np.abs(wanted.gradient).max()
    np.testing.assert_allclose(got.gradient, wanted.gradient, rtol=1e-8, atol=1e-10 * scale)


def test_any_policy_function_serves():
    x, theta = ca.SX.sym("x", 2), ca.SX.sym("theta", 3)
    law = ca.Function("law", [x, theta], [theta[0] * ca.tanh(theta[1] * x[0] + theta[2] * x[1])])
    step, *costs = case("wall", "barrier")
    answers = [
        RolloutFunction(step, *costs, HORIZON, RolloutPolicy(law, False), backend=backend)(
            np.array([[1.0, -2.0], [0.5, 0.0]]), np.array([1.0, 0.5, -0.3])
        )
        for backend in BACKENDS
    ]
    for answer in answers[:2]:
        np.testing.assert_allclose(answer.gradient, answers[2].gradient, rtol=1e-12)


@pytest.mark.cheap_cases("open-c")
@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("policy", ["open", "affine"])
def test_cost_of_input_increments(policy, backend):
    step, _, terminal = case("four", "barrier")
    system, du = step.system, ca.SX.sym("du", 2)
    value = ca.sumsqr(du) + 0.1 * ca.dot(system.u, du) + 0.01 * ca.sumsqr(system.x)
    stage = ca.Function("stage", [system.x, system.u, du, step.p.vector], [value])
    f = RolloutFunction(step, stage, terminal, HORIZON, POLICIES[policy](6, 2), backend=backend)
    given, before = inputs_of(f, 6, 2), np.array([0.3, -0.2])
    got = f(**given, u_before=before)
    h = 1e-6
    k = (0, 2, 1) if policy == "open" else (0, 5)
    ahead, behind = (given["theta"].copy() for _ in range(2))
    ahead[k] += h
    behind[k] -= h
    costs = [f(**{**given, "theta": t}, u_before=before).cost[0] for t in (ahead, behind)]
    np.testing.assert_allclose(got.gradient[k], (costs[0] - costs[1]) / (2 * h), rtol=1e-6)
    x, total, last = given["x0"][0], 0.0, before
    for t in range(HORIZON):
        theta = given["theta"][0, t] if policy == "open" else given["theta"][0]
        u = np.array(f.policy.law(x, theta))[:, 0] + given["noise"][0, t]
        total += float(stage(x, u, u - last, step.p.values))
        x, last = np.array(step.map(x, u, step.p.values)[0])[:, 0], u
    np.testing.assert_allclose(got.cost[0], total + float(terminal(x, step.p.values)), rtol=1e-12)
    with pytest.raises(ValueError, match="give u_before, the input before the first"):
        f(**given)
    with pytest.raises(ValueError, match="does not use it"):
        rollout("four", "barrier", policy)(**given, u_before=before)


def test_parameters_are_the_steps_own_or_one_row_a_sample():
    f = rollout("wall", "barrier", "open")
    x0, theta = np.array([0.1, -1.0]), np.ones((HORIZON, 1))
    own = f(x0, theta).cost
    np.testing.assert_array_equal(own, f(x0, theta, np.array([1e-3])).cost)
    swept = f(x0, theta, np.array([[1e-3], [1e-2]])).cost
    assert swept.shape == (2,)
    assert swept[0] == own[0] != swept[1]


def test_earlier_answer_is_written_over():
    f = rollout("wall", "barrier", "open")
    given = inputs(f, 10)
    first = f(**given)
    again = f(**{**given, "x0": given["x0"] + 1}, out=first)
    assert again.gradient is first.gradient
    with pytest.raises(ValueError, match=r"out for 'cost'.*shape \(3,\), not float64 of shape"):
        f(**inputs(f, 3), out=first)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"x0": np.zeros(3)}, r"'x0' of the rollout has 3 along axis 0, expected 2"),
        ({"theta": np.zeros((5, 1))}, r"theta has shape \(5, 1\); expected \(6, 1\), shared"),
        ({"theta": np.zeros((9, 5, 1))}, r"theta has shape .* or \(n_samples, 6, 1\)"),
        ({"noise": np.zeros((4, 5, 1))}, r"noise has shape \(4, 5, 1\); expected \(n_samples, 6"),
        ({"noise": np.zeros((6, 1))}, "samples, steps, inputs"),
        ({"p": np.zeros(2)}, r"'p' of the rollout has 2 along axis 0, expected 1"),
        ({"n_samples": 7}, r"\(samples\): 'x0' has 4, 'noise' has 4, 'n_samples' has 7"),
        ({"n_samples": -1}, "n_samples must be a whole number"),
        ({"score": True}, "a score needs Gaussian noise"),
        ({"noise": Gaussian(np.ones(3), 0)}, r"sigma has shape \(3,\); expected one number or"),
    ],
)
def test_wrong_input_is_explained(change, message):
    f = rollout("wall", "barrier", "open")
    given = {"x0": np.zeros((4, 2)), "theta": np.zeros((6, 1)), "noise": np.zeros((4, 6, 1))}
    with pytest.raises(ValueError, match=message):
        f(**{**given, **change})


def test_wrong_definitions_are_explained():
    step, stage, terminal = case("wall", "barrier")
    policy = open_loop(2, 1)
    with pytest.raises(ValueError, match="horizon must be a whole number of steps, at least 1"):
        RolloutFunction(step, stage, terminal, 0, policy)
    with pytest.raises(ValueError, match=r"terminal cost must be a function of \(x, p\) with size"):
        RolloutFunction(step, stage, stage, 3, policy)
    with pytest.raises(ValueError, match=r"policy must be a function of \(x, theta\) with sizes"):
        RolloutFunction(step, stage, terminal, 3, open_loop(3, 1))
    with pytest.raises(ValueError, match="must have one output with 1 entries"):
        RolloutFunction(step, stage, terminal, 3, open_loop(2, 2))
    with pytest.raises(ValueError, match=r"a policy is a function \(x, theta\) -> u"):
        RolloutPolicy(stage, per_step=False)


def compiled_texts(monkeypatch) -> list[str]:
    """Return a list to which all C texts are added that are compiled, or read from the cache, from now on."""
    from dynamics.batch.engines import compiler

    texts, load = [], compiler.load_library
    monkeypatch.setattr(compiler, "load_library", lambda text, *rest: texts.append(text) or load(text, *rest))
    return texts


def test_compiled_text_does_not_depend_on_the_horizon(monkeypatch):
    texts = compiled_texts(monkeypatch)
    step, *costs = case("wall", "barrier")
    for horizon in (2, 400):
        RolloutFunction(step, *costs, horizon, open_loop(2, 1), backend="c")(np.zeros(2), np.zeros((horizon, 1)))
    assert texts[0] == texts[1]


def test_the_adjoint_is_compiled_only_if_a_gradient_is_needed(monkeypatch):
    texts = compiled_texts(monkeypatch)
    step, *costs = case("wall", "barrier")
    f = RolloutFunction(step, *costs, HORIZON, open_loop(2, 1), backend="c")
    assert not texts
    calls = {"gradient": False}, {"gradient": True}, {"gradient": False}
    results = [f(np.array([0.1, -1.0]), np.ones((HORIZON, 1)), **call).cost for call in calls]
    assert ["static void backward(" in text for text in texts] == [False, True]
    np.testing.assert_array_equal(results, [results[0]] * 3)


@pytest.mark.costly_cases(
    "wall-exact-affine-c",
    "wall-adaptive-affine-per-step-c",
    "four-exact-open-c",
    "four-exact-affine-numpy",
    "four-adaptive-affine-c",
    "four-adaptive-affine-per-step-numpy",
)
@pytest.mark.one_case_in(4)
@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("policy", list(POLICIES))
@pytest.mark.parametrize("law", ["barrier", "exact", "adaptive"])
@pytest.mark.parametrize("system", list(SYSTEMS))
def test_costs_and_states_alone_have_the_same_bits(system, law, policy, backend):
    step, *costs = case(system, law)
    f = RolloutFunction(step, *costs, HORIZON, POLICIES[policy](step.system.nx, step.system.nu), backend=backend)
    values = np.tile(step.p.values, (35, 1)) * np.linspace(0.5, 2.0, 35)[:, None]
    for p in (None, values):
        given = inputs(f, 35) | {"p": p, "states": True}
        alone, full = f(**given, gradient=False), rollout(system, law, policy, backend)(**given)
        np.testing.assert_array_equal(alone.cost, full.cost)
        np.testing.assert_array_equal(alone.states, full.states)


def test_no_samples_are_no_answer():
    f = rollout("wall", "barrier", "open")
    empty = f(np.zeros((0, 2)), np.zeros((6, 1)))
    assert empty.gradient.shape == (0, 6, 1)
    assert f.moments(np.zeros((0, 2)), np.zeros((6, 1))).value.n == 0
