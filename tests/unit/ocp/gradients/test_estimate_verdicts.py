"""Verdicts on estimates: bias, discontinuities, heavy tails, samples that are not finite."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from dynamics.batch import Gaussian
from dynamics.contact import Exact
from ocp.errors import InputError
from ocp.gradients import estimate_gradient
from ocp.gradients.estimators import ConfidenceTest, FixedWeight
from ocp.gradients.verdict import empirical_bias, find_sharpest_change
from problems.registry import objective_spec
from tests.unit.ocp.gradients.test_estimators import rollout, static


@pytest.mark.costly
def test_the_confidence_test_holds_back_a_biased_first_order():
    objective = objective_spec("heaviside").objective()
    found = estimate_gradient(
        objective,
        ["alpha", "alpha-variance", "alpha-fixed"],
        50_000,
        0.2,
        rules=(ConfidenceTest(gamma=0.1), FixedWeight(alpha=0.25)),
    )
    true = float(objective.closed_form(0.2).gradient[0])
    assert found["alpha-variance"].choice.alpha == 1.0
    assert found["alpha-variance"].mean == 0.0
    assert abs(found["alpha"].mean[0] - true) <= 0.1
    choice = found["alpha"].choice
    np.testing.assert_allclose(choice.alpha * true + choice.epsilon, 0.1, rtol=0.02)
    np.testing.assert_allclose(found["alpha-fixed"].mean, 0.75 * true, rtol=0.03)
    smooth = estimate_gradient(static(lambda t: 2 * t, np.array([1.0])), ["alpha"], 50_000, 0.2)
    assert smooth["alpha"].choice.alpha == 1.0


def test_verdicts_tell_bias_from_empirical_bias():
    step = objective_spec("heaviside").objective()
    assert estimate_gradient(step, ["fobg"], 1000, 0.2)["fobg"].verdict.word == "biased"
    stiff = objective_spec("coulomb").objective({"nu": 1e-7})
    found = estimate_gradient(stiff, ["fobg", "zobg"], 1000, 0.2)
    assert found["fobg"].verdict.word == "empirically biased at this sample size"
    assert found["zobg"].verdict.word == "unbiased within the interval"
    # With the known mean, lemma III.4 shows that the samples' variance is too small.
    bias = found["fobg"].bias
    assert bias is not None and bias.sharp > bias.variance
    soft = objective_spec("coulomb").objective({"nu": 0.1})
    assert estimate_gradient(soft, ["fobg"], 1000, 0.2)["fobg"].verdict.word.startswith("unbiased")


def test_a_jump_is_told_from_a_steep_slope():
    noise = Gaussian(0.2, 0)
    jump = find_sharpest_change(objective_spec("heaviside").objective(), noise)
    assert jump.discontinuous
    assert jump.size == 1.0
    assert jump.width < 1e-12
    slope = find_sharpest_change(objective_spec("coulomb").objective({"nu": 1e-8}), noise)
    assert not slope.discontinuous
    assert not find_sharpest_change(rollout(law=Exact()), noise).discontinuous


@pytest.mark.costly
def test_lemma_three_four_holds_for_random_vectors():
    rng = np.random.default_rng(1)
    for _ in range(200):
        n, d = rng.integers(2, 400), rng.integers(1, 4)
        z = rng.standard_normal((n, d)) + 3 * rng.standard_normal(d)
        z[rng.random(n) < rng.uniform(0, 0.3)] += 30 * rng.standard_normal(d)
        found = empirical_bias(z)
        assert found.sharp <= found.variance * (1 + 1e-9)
        assert found.bound <= found.sharp * (1 + 1e-12)


def test_samples_that_are_not_finite_are_left_out_and_named():
    objective = static(lambda t: ca.log(t), np.array([0.1]))
    found = estimate_gradient(objective, ["fobg"], 20_000, 0.1, reference="none")["fobg"]
    w = Gaussian(0.1, np.random.SeedSequence(0, spawn_key=(1,))).draw(20_000, 1, 1).ravel()
    np.testing.assert_array_equal(found.nonfinite, np.flatnonzero(0.1 + w <= 0))
    np.testing.assert_allclose(found.mean, (1 / (0.1 + w))[0.1 + w > 0].mean(), rtol=1e-10)
    assert found.moments.n == 20_000 - len(found.nonfinite)
    with pytest.raises(InputError, match="not finite"):
        estimate_gradient(static(lambda t: ca.log(t) * ca.sqrt(t), np.array([-9.0])), ["fobg"], 50, 0.1)
