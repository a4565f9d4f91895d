"""Episodes under dense policies: ends, discounts, gradients, and agreement of all backends."""

from __future__ import annotations

import functools
import warnings

import casadi as ca
import numpy as np
import pytest

from dynamics.batch import (
    BatchWarning,
    Episode,
    EpisodeFunction,
    Gaussian,
    StepFunction,
    constant_policy,
    dense_policy,
)
from dynamics.contact import Barrier, Exact
from dynamics.systems import ContactSystem
from problems import get
from tests.unit.dynamics.batch.backends import BACKENDS
from tests.unit.dynamics.batch.rollout_cases import four_contacts, wall

SYSTEMS = {
    "closed form": wall,
    "inner loop": four_contacts,
    "path": lambda: get("hopper-1d").system,
}
POLICIES = {"affine": (), "network": (5, 7), "constant": None}
# Bound on the first state that ends an episode; some samples reach it, others do not.
WINDOW = {"wall": 0.7, "four contacts": 2.8, "hopper-1d": 1.5}
HORIZON, N, DISCOUNT = 8, 37, 0.9


def functions(system: ContactSystem) -> tuple[Episode, ca.Function]:
    """Return an episode that ends where the first state leaves a window, and a function for observations."""
    x, u, after, p = system.x, system.u, system.x_next, system.parameters.vector
    reward = after[0] - 0.1 * ca.sumsqr(u) + 0.3 * ca.sin(after[system.nx - 1])
    episode = Episode(
        ca.Function("reward", [x, u, after, p], [reward]),
        ca.Function("final", [x, p], [0.5 * x[0] ** 2]),
        ca.Function("done", [x, p], [ca.fabs(x[0]) > WINDOW[system.name]]),
    )
    return episode, ca.Function("observation", [x, p], [ca.vertcat(x, ca.sin(x[0]))])


@functools.cache
def rolled(system: str, policy: str, backend: str = "c", **options) -> EpisodeFunction:
    made = SYSTEMS[system]()
    episode, observe = functions(made)
    bounds, hidden = (-np.ones(made.nu), 2 * np.ones(made.nu)), POLICIES[policy]
    chosen = constant_policy(made.nx, *bounds) if hidden is None else dense_policy(observe, hidden, *bounds)
    step = Barrier(mu=1e-3).close(made)
    return EpisodeFunction(step, episode, HORIZON, chosen, backend=backend, **options)


def given(f: EpisodeFunction) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    values = {"discount": DISCOUNT}
    for name in f.policy.parameters.names:
        values[name] = 0.1 * rng.standard_normal() + name.startswith("scale")
    return {
        "x0": 0.3 * rng.standard_normal((N, f.tapes.nx - 2)),
        "theta": 0.5 * rng.standard_normal(f.policy.n_theta),
        "p": f.parameters.pack(values),
        "noise": 0.3 * rng.standard_normal((N, HORIZON, f.tapes.nu)),
    }


@pytest.mark.cheap_cases("closed form-constant", "closed form-network", "closed form-affine")
@pytest.mark.parametrize("policy", list(POLICIES))
@pytest.mark.parametrize("system", list(SYSTEMS))
def test_returns_are_those_of_a_loop_over_single_steps(system, policy):
    """The loop uses StepFunction, a network in NumPy, and explicit sums."""
    f = rolled(system, policy)
    made, call = SYSTEMS[system](), given(f)
    episode, observe = functions(made)
    step = StepFunction(Barrier(mu=1e-3).close(made))
    known = dict(zip(f.parameters.names, call["p"], strict=True))
    n = len(made.parameters)
    x, total, weight = call["x0"], np.zeros(N), np.ones(N)
    lived = np.zeros(N)
    for t in range(HORIZON):
        if POLICIES[policy] is None:
            a = np.tile(call["theta"], (N, 1))
        else:
            seen = np.array(observe.map(N)(x.T, ca.repmat(ca.DM(call["p"][:n]), 1, N))).T
            mean = np.array([known[f"mean[{i}]"] for i in range(seen.shape[1])])
            scale = np.array([known[f"scale[{i}]"] for i in range(seen.shape[1])])
            a = f.policy.mean_actions(call["theta"], (seen - mean) / scale)
        u = 0.5 + 1.5 * np.tanh(a + call["noise"][:, t])
        after = step(x, u).x_next
        alive = weight > 0
        for i in np.flatnonzero(alive):
            total[i] += weight[i] * float(episode.reward(x[i], u[i], after[i], call["p"][:n]))
        lived += alive
        x = np.where(alive[:, None], after, x)
        over = np.abs(x[:, 0]) > WINDOW[made.name]
        weight = np.where(over, 0.0, DISCOUNT * weight)
    total += weight * 0.5 * x[:, 0] ** 2
    found = f(**call, states=True)
    assert 0 < np.count_nonzero(lived < HORIZON) < N
    np.testing.assert_array_equal(found.lived, lived)
    np.testing.assert_allclose(found.value, total, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(found.states[:, -1], x, rtol=1e-9, atol=1e-9)


@pytest.mark.cheap_cases("closed form-constant", "inner loop-affine", "path-network")
@pytest.mark.parametrize("policy", list(POLICIES))
@pytest.mark.parametrize("system", list(SYSTEMS))
def test_gradients_are_the_differences(system, policy):
    """Central differences are along random directions in which no episode changes its end."""
    f = rolled(system, policy)
    call = given(f)
    found, rng, e = f(**call, gradient=True), np.random.default_rng(1), 1e-6
    for _ in range(3):
        d = rng.standard_normal(f.policy.n_theta)
        ends = [f(**{**call, "theta": call["theta"] + s * e * d}) for s in (1, -1)]
        same = (ends[0].lived == found.lived) & (ends[1].lived == found.lived)
        slope = (ends[0].value - ends[1].value) / (2 * e)
        assert same.mean() > 0.9
        np.testing.assert_allclose((found.gradient @ d)[same], slope[same], rtol=1e-5, atol=1e-6)


@pytest.mark.costly_cases("inner loop-affine-numpy", "path-affine-casadi")
@pytest.mark.one_case_in(10)
@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("policy", list(POLICIES))
@pytest.mark.parametrize("system", list(SYSTEMS))
def test_backends_agree(system, policy, backend):
    """Backends agree for one theta shared by all samples and for one theta per sample."""
    one, other = rolled(system, policy), rolled(system, policy, backend)
    call = given(one) | {"noise": Gaussian(0.3, seed=2)}
    own = call["theta"] + 0.1 * np.random.default_rng(3).standard_normal((N, one.policy.n_theta))
    for theta in (call["theta"], own):
        asked = {**call, "theta": theta, "gradient": True, "score": True, "states": True}
        a, b = one(**asked), other(**asked)
        for name in ("value", "lived", "gradient", "score", "trail"):
            np.testing.assert_allclose(getattr(b, name), getattr(a, name), rtol=1e-9, atol=1e-9)


@pytest.mark.cheap_cases("closed form")
@pytest.mark.parametrize("system", list(SYSTEMS))
def test_threads_and_blocks_change_no_bit(system):
    call = given(rolled(system, "network")) | {"noise": Gaussian(0.3, seed=2), "gradient": True}
    call["x0"] = np.tile(call["x0"], (60, 1))
    wanted = rolled(system, "network")(**call)
    for options in ({"threads": 2}, {"block": 8}):
        found = rolled(system, "network", **options)(**call)
        np.testing.assert_array_equal(found.gradient, wanted.gradient)
        np.testing.assert_array_equal(found.value, wanted.value)


@pytest.mark.parametrize("policy", list(POLICIES))
def test_moments_are_those_of_the_samples(policy):
    f = rolled("inner loop", policy)
    call = given(f) | {"noise": Gaussian(0.3, seed=2)}
    single = f(**call, gradient=True, score=True)
    whole = f.moments(**call, score=True, baseline=0.7)
    zeroth = (single.value - 0.7)[:, None] * single.score
    for moments, samples in (
        (whole.value, single.value),
        (whole.gradient, single.gradient),
        (whole.zeroth, zeroth),
    ):
        np.testing.assert_allclose(moments.mean, samples.mean(axis=0), rtol=1e-12, atol=1e-13)
        np.testing.assert_allclose(moments.m2 / (N - 1), samples.var(axis=0, ddof=1), rtol=1e-10, atol=1e-13)


def test_the_zeroth_order_gradient_has_the_first_order_ones_mean():
    """With smoothed contact and no episode's end nearby, likelihood-ratio and pathwise means agree."""
    f = rolled("closed form", "constant")
    call = given(f)
    call |= {"x0": np.array([0.1, 0.0]), "noise": Gaussian(0.2, seed=5), "n_samples": 400_000}
    found = f.moments(**call, score=True, baseline=f(call["x0"], call["theta"]).value[0])
    error = np.sqrt(found.zeroth.m2 / found.zeroth.n**2 + found.gradient.m2 / found.gradient.n**2)
    assert np.all(f(**{**call, "n_samples": 10_000}).lived == HORIZON)
    assert np.all(np.abs(found.zeroth.mean - found.gradient.mean) < 4 * error)


@pytest.mark.costly
@pytest.mark.parametrize("backend", BACKENDS)
def test_a_gradient_along_given_states(backend):
    """Along the rollout's states it is the ordinary gradient; along exact states it chains the law's slopes there."""
    f = rolled("inner loop", "constant", backend)
    call = given(f)
    plain = f(**call, gradient=True, states=True)
    again = f(**call, gradient=True, linearise_along=plain)
    np.testing.assert_allclose(again.gradient, plain.gradient, rtol=1e-12, atol=1e-13)

    made = SYSTEMS["inner loop"]()
    episode, _ = functions(made)
    exact = EpisodeFunction(
        Exact().close(made),
        episode,
        HORIZON,
        constant_policy(made.nx, -np.ones(made.nu), 2 * np.ones(made.nu)),
    )
    n_exact = len(exact.parameters)
    p_exact = np.concatenate([made.parameters.values, [DISCOUNT]])
    assert len(p_exact) == n_exact
    followed = exact(call["x0"], call["theta"], p_exact, call["noise"], states=True)
    found = f(**call, gradient=True, linearise_along=followed)

    slopes = StepFunction(Barrier(mu=1e-3).close(made))
    a = np.tanh(call["theta"] + call["noise"])
    U = 0.5 + 1.5 * a
    p, by_theta = made.parameters.values, 1.5 * (1 - a**2)
    x, u, after = made.x, made.u, made.x_next
    of_reward = ca.Function(
        "slopes",
        [x, u, after, made.parameters.vector],
        [ca.gradient(episode.reward(x, u, after, made.parameters.vector), v) for v in (x, u, after)],
    )
    for i in range(5):
        X, H = followed.states[i], int(followed.lived[i])
        total = np.zeros(made.nu)
        whole = H == HORIZON and abs(X[-1, 0]) <= WINDOW[made.name]
        bar = np.zeros(made.nx)
        bar[0] = X[-1, 0] * DISCOUNT**HORIZON * whole
        for t in reversed(range(H)):
            steps, A, B = slopes.derivatives(X[t][None], U[i, t][None])
            by_x, by_u, by_after = (np.array(g).ravel() for g in of_reward(X[t], U[i, t], steps.x_next[0], p))
            through = bar + DISCOUNT**t * by_after
            total += (B[0].T @ through + DISCOUNT**t * by_u) * by_theta[i, t]
            bar = A[0].T @ through + DISCOUNT**t * by_x
        np.testing.assert_allclose(found.gradient[i], total, rtol=1e-8, atol=1e-10)


def test_what_a_finished_sample_becomes_is_nobodys_business():
    """A sample that becomes infinite after its end keeps its return and gradient."""
    made = wall()
    x, u, after, p = made.x, made.u, made.x_next, made.parameters.vector
    burst = ca.if_else(x[0] > 0.7, ca.log(-ca.fabs(x[0])), 1)
    episode = Episode(
        ca.Function("reward", [x, u, after, p], [burst * after[0]]),
        ca.Function("final", [x, p], [ca.log(0.7 - x[0])]),
        ca.Function("done", [x, p], [x[0] > 0.7]),
    )
    f = EpisodeFunction(Barrier(mu=1e-3).close(made), episode, 6, constant_policy(made.nx, -1, 1))
    found = f(np.array([[0.69, 3.0]]), np.array([0.3]), gradient=True)
    assert found.lived[0] < 6
    assert np.isfinite(found.value).all()
    assert np.isfinite(found.gradient).all()


def test_bad_input_is_told():
    f = rolled("closed form", "network")
    call = given(f)
    with pytest.raises(ValueError, match="linearise_along needs episodes of 8 steps"):
        f(**call, linearise_along=f(**call))
    with pytest.raises(ValueError, match="'linearise_along' has 2"):
        f(**call, linearise_along=f(**call | {"x0": call["x0"][:2], "noise": call["noise"][:2]}, states=True))
    with pytest.raises(ValueError, match="'terminal_gradient' of the rollout"):
        f(**call, terminal_gradient=np.ones(9))
    with pytest.raises(ValueError, match="not kept; pass states=True"):
        _ = f(**call).states
    with pytest.raises(ValueError, match="a score needs Gaussian noise"):
        f(**call, score=True)
    with pytest.raises(ValueError, match="theta has shape"):
        f(**{**call, "theta": call["theta"][1:]})
    with pytest.raises(ValueError, match="layers must have whole sizes of at least 1"):
        dense_policy(functions(wall())[1], (0,), -1, 1)
    with pytest.raises(ValueError, match="finite bounds, lower below upper"):
        constant_policy(2, 1, -1)
    with warnings.catch_warnings():
        warnings.simplefilter("error", BatchWarning)
        f(**call)


@pytest.mark.costly_cases("numpy")
@pytest.mark.parametrize("backend", BACKENDS)
def test_another_horizon_is_that_horizon(backend):
    f = rolled("inner loop", "network", backend)
    call = given(f) | {"gradient": True, "states": True}
    short = f.with_horizon(3)(**{**call, "noise": call["noise"][:, :3]})
    again = f(**call)
    made = EpisodeFunction(
        Barrier(mu=1e-3).close(four_contacts()),
        functions(four_contacts())[0],
        3,
        f.policy,
        backend=backend,
    )
    wanted = made(**{**call, "noise": call["noise"][:, :3]})
    for name in ("value", "gradient", "trail"):
        np.testing.assert_array_equal(getattr(short, name), getattr(wanted, name))
    assert again.trail.shape[1] == HORIZON + 1
    with pytest.raises(ValueError, match="horizon must be a whole number"):
        f.with_horizon(0)


@pytest.mark.cheap_cases("c")
@pytest.mark.parametrize("backend", BACKENDS)
def test_what_else_is_gained_at_the_end_pulls_on_the_gradient(backend):
    """A gradient added at the last state equals that of an episode with the same quadratic final reward."""
    f, made = rolled("inner loop", "network", backend), four_contacts()
    call = given(f) | {"gradient": True, "states": True}
    plain = f(**call)
    reached = (plain.lived == HORIZON) & (np.abs(plain.states[:, -1, 0]) <= WINDOW[made.name])
    assert 0 < reached.sum() < N
    x, p = made.x, made.parameters.vector
    episode, _ = functions(made)
    more = ca.Function("final", [x, p], [episode.final(x, p) + 0.3 * ca.sumsqr(x)])
    other = EpisodeFunction(
        Barrier(mu=1e-3).close(made), Episode(episode.reward, more, episode.done), HORIZON, f.policy
    )
    pull = 0.6 * plain.states[:, -1] * (DISCOUNT**HORIZON * reached)[:, None]
    np.testing.assert_allclose(
        f(**call, terminal_gradient=pull).gradient, other(**call).gradient, rtol=1e-9, atol=1e-10
    )
