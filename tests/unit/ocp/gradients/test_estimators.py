"""Gradient estimators on objectives with known gradients: linear, quadratic, discontinuous, through contact."""

from __future__ import annotations

import functools

import casadi as ca
import numpy as np
import pytest

from dynamics.batch import Gaussian
from dynamics.contact import Barrier
from dynamics.systems import ParameterTable, Signal
from ocp.errors import InputError
from ocp.gradients import RolloutObjective, StaticObjective, estimate_gradient, sampling
from ocp.gradients.estimators import SAMPLED, ConfidenceTest, FixedWeight
from ocp.problem.policy import Feedback, OpenLoop
from problems import get, names

BACKENDS = ("c", "numpy", "casadi")


def static(cost, value, **engine):
    theta = ca.SX.sym("theta", len(value))
    signals = tuple(Signal(f"theta{i}", "m") for i in range(len(value)))
    return StaticObjective("test", signals, theta, cost(theta), value, ParameterTable(()), **engine)


@functools.cache
def rollout(name="wall-1d", law=None, policy=None, **engine):
    return RolloutObjective(get(name, N=8), law or Barrier(mu=1e-2), policy, **engine)


@pytest.mark.costly
@pytest.mark.parametrize("name", [*SAMPLED, "alpha", "alpha-variance", "alpha-fixed"])
def test_every_estimator_finds_the_gradient_of_a_quadratic(name):
    # F = E |theta + w|^2 + 3 = |theta|^2 + d sigma^2 + 3, so grad F = 2 theta.
    value = np.array([0.5, -1.0, 0.25])
    objective = static(lambda t: ca.sumsqr(t) + 3, value)
    found = estimate_gradient(objective, [name], 200_000, 0.3, seed=1)[name]
    assert np.all(np.abs(found.mean - 2 * value) <= 5 * found.standard_error)
    assert found.verdict.word == "unbiased within the interval"
    low, high = found.interval(0.999999)
    assert np.all((low < 2 * value) & (2 * value < high))


@pytest.mark.costly
def test_variance_of_one_sample_is_that_of_the_theory():
    # f = g (theta + w): FoBG has no variance; a ZoBG sample g w^2/sigma^2 + b w/sigma^2 has
    # variance 2 g^2 + b^2/sigma^2 with b = f(theta) - baseline.
    g, b, sigma = 2.0, 1.5, 0.5
    objective = static(lambda t: g * t, np.array([b / g]))
    names = ["zobg", "zobg-zero-noise", "zobg-mean", "zobg-antithetic", "es", "fobg"]
    found = estimate_gradient(objective, names, 400_000, sigma)
    variance = {name: float(found[name].variance[0]) for name in names}
    np.testing.assert_allclose(variance["zobg"], 2 * g**2 + (b / sigma) ** 2, rtol=0.03)
    for name in names[1:5]:
        np.testing.assert_allclose(variance[name], 2 * g**2, rtol=0.03)
    assert variance["fobg"] == 0
    assert found["fobg"].mean == g


def test_the_mean_of_the_others_is_left_out():
    """The estimator equals its definition, in which each sample's baseline is the mean of all others."""
    objective = static(lambda t: ca.exp(t), np.array([0.2]))
    seed = np.random.SeedSequence(7)
    found = estimate_gradient(objective, ["zobg-mean"], 50, 0.4, seed=seed, reference="none")
    child = np.random.SeedSequence(seed.entropy, spawn_key=(0,))
    w = Gaussian(0.4, child).draw(50, 1, 1).ravel()
    cost = np.exp(0.2 + w)
    others = np.array([np.delete(cost, i).mean() for i in range(50)])
    samples = (cost - others) * w / 0.16
    np.testing.assert_allclose(found["zobg-mean"].mean, samples.mean(), rtol=1e-12)
    np.testing.assert_allclose(found["zobg-mean"].variance, samples.var(ddof=1), rtol=1e-12)


@pytest.mark.cheap_cases("policy2")
@pytest.mark.parametrize("policy", [OpenLoop(), Feedback(), Feedback(stationary=True)])
def test_mirrored_noise_is_the_noise_turned_round(policy):
    """Mirrored samples have the costs and scores of -w, also under feedback, which reacts to the noise."""
    objective = RolloutObjective(get("push-disc", N=5), Barrier(mu=1e-2), policy)
    rng = np.random.default_rng(0)
    objective.theta = objective.theta + 0.1 * rng.standard_normal(len(objective.theta))
    noise = Gaussian(0.2, seed=3)
    drawn = noise.draw(20, 5, 2).reshape(20, -1)
    mirrored = objective.sample_scores(noise.negate(), 20)
    np.testing.assert_allclose(mirrored.cost, objective.costs(-drawn), rtol=1e-11)
    if isinstance(policy, OpenLoop):
        np.testing.assert_allclose(mirrored.direction, -drawn / 0.04, rtol=1e-11)
    else:
        # The score's entries for k do not depend on the states.
        K = objective.problem.system.nx * 2
        got = mirrored.direction.reshape(20, -1, K + 2)[:, :, K:].sum(axis=1)
        np.testing.assert_allclose(got, -drawn.reshape(20, 5, 2).sum(axis=1) / 0.04, atol=1e-9)
        straight = objective.sample_scores(noise, 20).direction
        assert np.abs(straight + mirrored.direction).max() > 1e-3


# Differences along every input of a long horizon would take minutes.
SHORT = {
    **{name: {"N": 6} for name in ("box-slide", "ball-throw", "cart-transport", "hopper-1d")},
    "cart-walls": {"N": 12},
    "ball-bounce": {"N": 12},
    "planar-push": {"N": 4},
    "planar-hand": {"N": 2},
    "hopper": {"N": 2},
    "half-cheetah": {"N": 2},
    **{name: {"N": 2} for name in ("quadruped", "ant", "push-cube", "reorient")},
    **{name: {"N": 3} for name in ("spinner", "finger-disc", "idto-hopper", "soft-walls")},
}
# The kernels of these problems take almost a minute to compile.
LARGE = ("hopper", "half-cheetah", "quadruped", "ant", "push-cube", "reorient")
NAMES = [pytest.param(n, marks=[pytest.mark.slow] if n in LARGE else []) for n in names()]


@pytest.mark.costly_cases("ball-bounce-c", "planar-push-c", "soft-walls-c", "idto-hopper-c")
@pytest.mark.one_case_in(9)
@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("name", NAMES)
def test_first_order_gradients_equal_differences(name, backend):
    """Each sample's first-order gradient through contact equals central differences of its cost."""
    problem = get(name, **SHORT.get(name, {}))
    objective = RolloutObjective(problem, Barrier(mu=1e-3), backend=backend)
    rng = np.random.default_rng(5)
    scale = objective.problem.scaling.u
    objective.theta = objective.theta + 0.2 * scale * rng.standard_normal(len(objective.theta))
    noise = Gaussian(0.1 * scale, seed=2)
    n = 3
    gradient = objective.sample_gradients(noise, n).direction
    drawn = noise.draw(n, objective.problem.N, objective.problem.system.nu).reshape(n, -1)
    difference = np.empty_like(gradient)
    for k in range(gradient.shape[1]):
        difference[:, k] = _slope(objective, drawn, k, 2e-4 * scale)
    size = np.abs(difference).max(axis=1, keepdims=True)
    np.testing.assert_allclose(gradient / size, difference / size, atol=1e-6)
    assert size.min() > 0


def _slope(objective, noise, k, h):
    """Return the sixth-order central difference of costs along component k of the noise, which is added to theta."""
    total = np.zeros(len(noise))
    for step, weight in ((1, 3 / 4), (2, -3 / 20), (3, 1 / 60)):
        for sign in (1, -1):
            moved = noise.copy()
            moved[:, k] += sign * step * h
            total += sign * weight * objective.costs(moved)
    return total / h


@pytest.mark.cheap_cases("push-1d-policy1-0.2")
@pytest.mark.parametrize(
    ("name", "policy", "sigma"),
    [
        ("push-1d", OpenLoop(), 0.2),
        ("push-1d", Feedback(stationary=True), 0.2),
        ("planar-push", OpenLoop(), 0.1),  # several contacts with friction
        ("planar-hand", OpenLoop(), 0.1),
    ],
)
def test_all_estimators_agree_through_contact(name, policy, sigma):
    objective = rollout(name, policy=policy)
    if name != "push-1d":
        objective = RolloutObjective(get(name, N=3), Barrier(mu=1e-2))
    found = estimate_gradient(
        objective,
        ["zobg-mean", "zobg-antithetic", "fobg", "alpha"],
        30_000,
        sigma,
        seed=3,
    )
    for estimate in found.values():
        assert estimate.verdict.word == "unbiased within the interval"
        off = estimate.mean - estimate.reference.gradient
        width = np.hypot(estimate.standard_error, estimate.reference.standard_error)
        assert np.all(np.abs(off) <= 5 * width)
    assert found["fobg"].variance.sum() < found["zobg-mean"].variance.sum()


def test_evolution_strategies_equal_pairs_in_open_loop_and_smooth_gains_under_feedback():
    found = estimate_gradient(rollout(), ["es", "fobg"], 20_000, 0.1)
    assert found["es"].verdict.word == "unbiased within the interval"
    gains = estimate_gradient(rollout(policy=Feedback(stationary=True)), ["es"], 100, 0.1)
    assert gains["es"].verdict.word == "no reference"
    assert gains["es"].row()["reference"] is None


@pytest.mark.costly
@pytest.mark.parametrize("kept", [1, 1 << 20])
def test_bits_depend_on_neither_threads_nor_blocks_and_follow_the_seed(kept, monkeypatch):
    monkeypatch.setattr(sampling, "_MAX_STORED_VALUES", kept)
    answers = []
    for threads, block in ((1, 8), (2, 8), (1, 64), (2, 64)):
        for objective in (
            RolloutObjective(get("wall-1d", N=5), Barrier(mu=1e-2), threads=threads, block=block),
            static(lambda t: ca.sin(ca.sumsqr(t)), np.ones(2), threads=threads, block=block),
        ):
            found = estimate_gradient(objective, ["zobg-mean", "fobg", "alpha"], 20_000, 0.2, seed=9)
            answers.append([(e.mean.tobytes(), e.moments.m2.tobytes()) for e in found.values()])
    for k in (0, 1):
        assert all(answer == answers[k] for answer in answers[k::2])
    objective = static(lambda t: ca.sin(ca.sumsqr(t)), np.ones(2))
    means = [estimate_gradient(objective, ["zobg"], 100, 0.2, seed=s)["zobg"].mean for s in (0, 0, 1)]
    np.testing.assert_array_equal(means[0], means[1])
    assert np.all(means[0] != means[2])


def test_first_samples_of_a_larger_run_are_the_same():
    objective = rollout()
    few = SAMPLED["fobg"].make_sampler(objective, Gaussian(0.1, 0), 10).single(Gaussian(0.1, 0), 10)
    many = SAMPLED["fobg"].make_sampler(objective, Gaussian(0.1, 0), 500).single(Gaussian(0.1, 0), 500)
    np.testing.assert_array_equal(few, many[:10])


def test_orders_use_independent_samples():
    # The cost equals its gradient, so that equal noise would correlate both orders by 1.
    objective = static(lambda t: ca.exp(t), np.array([0.0]))
    seed = np.random.SeedSequence(0)
    parts = []
    for name in ("zobg-mean", "fobg"):
        estimator = SAMPLED[name]
        child = np.random.SeedSequence(seed.entropy, spawn_key=(estimator.stream,))
        noise = Gaussian(0.3, child)
        parts.append(estimator.make_sampler(objective, noise, 5000).single(noise, 5000)[:, 0])
    assert abs(np.corrcoef(*parts)[0, 1]) < 0.06


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"samples": 1}, "one sample has no variance"),
        ({"samples": 2.5}, "whole number"),
        ({"sigma": 0.0}, "must be a .*number >= 1e-150 and <= 1e\\+150"),
        ({"sigma": -1.0}, "must be a .*number >= 1e-150 and <= 1e\\+150"),
        ({"sigma": float("nan")}, "must be a .*number >= 1e-150 and <= 1e\\+150"),
        ({"estimators": ["zobh"]}, "did you mean 'zobg'"),
        ({"estimators": ["fobg", "fobg"]}, "named twice"),
        ({"estimators": []}, "at least one"),
        ({"reference": "closed"}, "did you mean 'closed-form'"),
        ({"reference_samples": 1}, "one sample has no variance"),
    ],
)
def test_bad_input_has_its_sentence(settings, sentence):
    objective = static(lambda t: t, np.array([1.0]))
    with pytest.raises(InputError, match=sentence):
        estimate_gradient(objective, **settings)


@pytest.mark.parametrize(
    "make",
    [
        lambda: ConfidenceTest(gamma=0.0),
        lambda: ConfidenceTest(delta=1.0),
        lambda: ConfidenceTest(deviation=-1.0),
        lambda: FixedWeight(alpha=1.5),
    ],
)
def test_rules_refuse_what_they_cannot_mean(make):
    with pytest.raises(InputError):
        make()


def test_an_objective_is_turned_without_being_built_again():
    objective = rollout()
    other = objective.at({"contact.mu": 1e-1, "u[2]": 0.3, "x0": 0.5})
    fresh = RolloutObjective(get("wall-1d", N=8, x0=0.5), Barrier(mu=1e-1))
    zeros = np.zeros((1, objective.n_noise))
    zeros[0, 2] = 0.3
    np.testing.assert_allclose(other.nominal_cost(), fresh.costs(zeros)[0], rtol=1e-12)
    assert objective.nominal_cost() != other.nominal_cost()
    with pytest.raises(InputError, match="no parameter 'y0'"):
        objective.at({"y0": 1.0})


def test_scenarios_are_averaged_over():
    problem = get("push-disc", N=4, scenarios=3)
    objective = RolloutObjective(problem, Barrier(mu=1e-2))
    starts = problem.initial_states(problem.parameters.values)
    singles = []
    for x0 in starts:
        alone = RolloutObjective(get("push-disc", N=4, ox0=x0[0], oy0=x0[1]), Barrier(mu=1e-2))
        singles.append(alone.nominal_cost())
    np.testing.assert_allclose(objective.nominal_cost(), np.mean(singles), rtol=1e-12)


@pytest.mark.parametrize("name", ["zobg", "zobg-zero-noise", "zobg-mean", "fobg"])
def test_moments_in_bulk_are_those_of_single_samples(name, monkeypatch):
    monkeypatch.setattr(sampling, "_MAX_STORED_VALUES", 1)
    objective, n = rollout(), 20_000
    noise = Gaussian(0.1, 3)
    bulk = sampling.run_estimator(objective, SAMPLED[name], noise, n)
    assert len(bulk.first_samples) < n
    values = SAMPLED[name].make_sampler(objective, noise, n).single(noise, n)
    np.testing.assert_allclose(bulk.moments.mean, values.mean(axis=0), rtol=1e-9)
    np.testing.assert_allclose(bulk.moments.variance, values.var(axis=0, ddof=1), rtol=1e-9)
    assert bulk.moments.n == n
