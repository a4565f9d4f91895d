"""Heaviside and Coulomb objectives: closed forms and estimators agree with independent numbers."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ocp.gradients import estimate_gradient
from ocp.gradients.estimators import ConfidenceTest, Evidence, inverse_variance
from ocp.gradients.sampling import quadrature
from ocp.gradients.verdict import empirical_bias
from problems.library import coulomb, heaviside
from problems.registry import objective_spec

# Numbers from quadrature and enumeration that share no code with this project.
HEAVISIDE = [
    (0.3, 0.5, {"objective": 0.7257468822499265, "zobg_variance": 1.6590939381697962}),
    (-0.4, 0.2, {"gradient": 0.2699548325659403}),
    (0.0, 1.0, {"objective": 0.5, "gradient": 0.3989422804014327, "zobg_variance": 0.3408450569081047}),
]
COULOMB = [
    (0.05, 0.1, 1.0, {"objective": 0.039861016065639715, "fobg_variance": 15.296632261945392}),
    (0.3, 0.2, 0.5, {"fobg_variance": 11.510750229112192, "zobg_variance": 2.110036867770157}),
    (
        0.0,
        0.01,
        1.0,
        {"gradient": 0.7978812362963289, "fobg_variance": 158.93963279203203, "zobg_variance": 0.36338551946823694},
    ),
    (0.5, 1.0, 0.5, {"objective": 0.609548422215397, "fobg_variance": 0.9979297259853618}),
]


@pytest.mark.parametrize(("theta", "sigma", "expected"), HEAVISIDE)
def test_heaviside(theta, sigma, expected):
    found = heaviside.closed_form({"theta": theta}, sigma)
    for key, value in expected.items():
        np.testing.assert_allclose(np.ravel(getattr(found, key)), value, rtol=1e-10)
    assert found.fobg_mean == found.fobg_variance == 0


@pytest.mark.parametrize(("theta", "nu", "sigma", "expected"), COULOMB)
def test_coulomb(theta, nu, sigma, expected):
    found = coulomb.closed_form({"theta": theta, "nu": nu}, sigma)
    for key, value in expected.items():
        np.testing.assert_allclose(np.ravel(getattr(found, key)), value, rtol=1e-10)
    np.testing.assert_array_equal(found.fobg_mean, found.gradient)


def test_variances_with_a_baseline():
    np.testing.assert_allclose(heaviside.zobg_variance(0.0, 1.0, 1.0), 0.3408450569081047, rtol=1e-10)
    np.testing.assert_allclose(heaviside.zobg_variance(-0.4, 0.2, 0.0), 3.195426012738178, rtol=1e-10)
    np.testing.assert_allclose(coulomb.zobg_variance(0.3, 0.2, 0.5, 1.0), 5.662444491551283, rtol=1e-10)
    np.testing.assert_allclose(coulomb.zobg_variance(0.5, 1.0, 0.5, 1.0), 3.884147585254282, rtol=1e-10)


def test_probability_of_a_gradient_that_is_not_zero():
    found = coulomb.closed_form({"theta": 0.3, "nu": 0.2}, 0.5)
    np.testing.assert_allclose(found.gradient * 0.2 / 2, 0.13272285980627915, rtol=1e-10)


@pytest.mark.costly
@pytest.mark.parametrize("sigma", [0.1, 1.0])
@pytest.mark.parametrize("theta", [-0.5, 0.0, 0.3])
@pytest.mark.parametrize(("name", "nu"), [("heaviside", None), ("coulomb", 1e-3), ("coulomb", 1e-1)])
def test_estimators_have_their_means_and_variances(name, nu, theta, sigma):
    """They agree within 5 standard errors at 1e6 samples; a variance's error follows from the fourth moment."""
    values = {"theta": theta} | ({} if nu is None else {"nu": nu})
    objective = objective_spec(name).objective(values)
    known = objective.closed_form(sigma)
    found = estimate_gradient(objective, ("zobg", "fobg"), 1_000_000, sigma, seed=4)
    wanted = {
        "zobg": (known.gradient, known.zobg_variance, _zobg_fourth(name, values, sigma)),
        "fobg": (known.fobg_mean, known.fobg_variance, _fobg_fourth(name, values, sigma)),
    }
    for key, (mean, variance, fourth) in wanted.items():
        n = found[key].moments.n
        assert n == 1_000_000
        allowed = 5 * math.sqrt(float(variance[0]) / n) + 1e-12
        assert abs(found[key].mean - mean) <= allowed, key
        spread = math.sqrt(max(fourth - float(variance[0]) ** 2, 0.0) / n)
        assert abs(found[key].variance - variance) <= 5 * spread + 1e-12, key


def _zobg_fourth(name, values, sigma):
    """Return the fourth central moment of one zeroth-order sample, by the midpoint rule."""
    t = 10 * (2 * (np.arange(1 << 20) + 0.5) / (1 << 20) - 1)
    weight = np.exp(-(t**2) / 2) / math.sqrt(2 * math.pi) * 20 / len(t)
    where = values["theta"] + sigma * t
    f = where >= 0 if name == "heaviside" else np.clip(2 * where / values["nu"], -1, 1)
    z = f * t / sigma
    return float(np.sum(weight * (z - np.sum(weight * z)) ** 4))


def _fobg_fourth(name, values, sigma):
    """Return the fourth central moment of one first-order sample, which has two possible values."""
    if name == "heaviside":
        return 0.0
    nu = values["nu"]
    p = coulomb.closed_form(values, sigma).gradient[0] * nu / 2
    return (2 / nu) ** 4 * p * (1 - p) * ((1 - p) ** 3 + p**3)


@pytest.mark.costly
@pytest.mark.parametrize(
    "repetitions",
    [(300, 240, 150, 90), pytest.param((1000, 800, 500, 300), marks=pytest.mark.slow)],
)
def test_error_falls_with_the_root_of_the_number_of_samples(repetitions):
    objective = objective_spec("heaviside").objective({"theta": 0.3})
    true = float(objective.closed_form(0.5).gradient[0])
    sizes = np.array([100, 1000, 10_000, 50_000])
    errors = []
    for n, runs in zip(sizes, repetitions, strict=True):
        off = [
            estimate_gradient(objective, ["zobg"], int(n), 0.5, seed=seed, reference="none")["zobg"].mean[0] - true
            for seed in range(runs)
        ]
        errors.append(np.sqrt(np.mean(np.square(off))))
    slope = np.polyfit(np.log(sizes), np.log(errors), 1)[0]
    assert abs(slope + 0.5) < 0.05


@pytest.mark.parametrize(("name", "theta"), [("heaviside", 0.1), ("coulomb", 0.05)])
def test_quadrature_agrees_with_the_closed_form(name, theta):
    objective = objective_spec(name).objective({"theta": theta})
    found, known = quadrature(objective, 0.3), objective.closed_form(0.3)
    np.testing.assert_allclose(found.gradient, known.gradient, rtol=1e-4)
    assert abs(found.gradient - known.gradient)[0] <= 3 * found.standard_error[0] + 1e-9


@pytest.mark.costly
def test_the_empirical_bias_of_coulomb_friction():
    """At theta = nu/2, nu = 0.1, sigma = 1 the triple is (p, 2p/nu, 0)."""
    p, Delta = 0.03982783727702898, 0.7965567455405796
    found = empirical_bias(np.array([[0.0]] * 9601723 + [[20.0]] * 398277)[::50])
    np.testing.assert_allclose([found.beta, found.Delta, found.S], [p, Delta, 0.0], atol=2e-4)
    objective = objective_spec("coulomb").objective({"theta": 0.05, "nu": 0.1})
    bias = estimate_gradient(objective, ["fobg"], 400_000, 1.0)["fobg"].bias
    np.testing.assert_allclose([bias.beta, bias.Delta], [p, Delta], rtol=0.02)
    assert bias.S == 0
    # sharp: (1 - beta)/beta Delta^2 is the very variance of a sample with two values.
    np.testing.assert_allclose(bias.sharp, (1 - p) / p * Delta**2, rtol=0.03)
    np.testing.assert_allclose(bias.sharp, 15.296632261945392, rtol=0.03)
    assert bias.bound < bias.sharp


def test_alpha_weighs_the_first_order():
    """Papers disagree on which order alpha weighs; the reference weighs the zeroth order, so its alpha is 1 - ours."""
    infeasible = Evidence(100, 1, 1.0, 1.0, 0.5, 1.0, 0.0)
    n = 2 * math.log(2 / 0.05) / 0.36  # epsilon = 0.6 with variance 1 and no deviation
    exact = Evidence(n, 1, 1.0, 1.0, 0.5, 1.0, 0.0)
    assert ConfidenceTest(gamma=0.5).choose_weight(exact).alpha == 1 - 1.0
    assert ConfidenceTest(gamma=0.5).choose_weight(infeasible).alpha > 0
    alpha = inverse_variance(first_variance=0.5, zeroth_variance=3.0)
    np.testing.assert_allclose(alpha, 3 / 3.5)
    least = alpha**2 * 0.5 + (1 - alpha) ** 2 * 3
    np.testing.assert_allclose(least, 0.42857142857142855, rtol=1e-12)
