"""Likelihood, bounds, elites and training of the ensemble agree with numbers computed by hand."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

from ocp.learning.mbpo_networks import (
    Ensemble,
    begin_learner,
    likelihood_loss,
    make_trainer,
    member_errors,
    predict_gaussians,
    sample_next_states,
    select_elites,
)


def affine(*members: tuple[float, float, float, float]) -> Ensemble:
    """Return an ensemble of one-layer members (w, b, s, c): mean ``w z + b``, raw log-variance ``s z + c``."""
    W = jnp.array([[[w], [s]] for w, _, s, _ in members])
    b = jnp.array([[b, c] for _, b, _, c in members])
    return Ensemble(((W, b),), jnp.array([-3.0]), jnp.array([1.0]))


def softplus(s):
    return np.log1p(np.exp(s))


def bounded(raw):
    below = 1.0 - softplus(1.0 - raw)
    return -3.0 + softplus(below + 3.0)


@pytest.mark.costly
def test_log_variances_lie_between_their_bounds():
    raw = np.array([-50.0, -2.0, 0.0, 0.7, 60.0])
    z = jnp.asarray(raw)[None, :, None]
    mean, log_var = predict_gaussians(affine((2.0, 0.5, 1.0, 0.0)), z)
    assert mean[0, :, 0] == pytest.approx(2 * raw + 0.5, rel=1e-6)
    assert log_var[0, :, 0] == pytest.approx(bounded(raw), abs=2e-6)
    # Softplus stays above its asymptote, so that the upper bound is exceeded by up to softplus(-4).
    assert (log_var >= -3).all() and (log_var <= 1 + softplus(-4.0) + 1e-6).all()


@pytest.mark.costly
def test_the_loss_is_the_likelihood_by_hand():
    """Each of two members has two rows of its own."""
    ensemble = affine((1.0, 0.0, 0.0, -1.0), (0.0, 2.0, 0.5, 0.0))
    z, y = np.array([[1.0, 2.0], [3.0, -1.0]]), np.array([[1.5, 1.0], [2.0, 2.5]])
    means = np.array([[1.0, 2.0], [2.0, 2.0]])
    log_var = bounded(np.array([[-1.0, -1.0], [1.5, -0.5]]))
    each = (means - y) ** 2 / np.exp(log_var) + log_var
    expected = each.mean(axis=1).sum() + 0.01 * (1.0 + 3.0)
    found = likelihood_loss(ensemble, jnp.asarray(z)[..., None], jnp.asarray(y)[..., None])
    assert float(found) == pytest.approx(expected, rel=1e-5)


def test_elites_are_those_that_err_least_on_rows_held_out():
    ensemble = affine((1.0, 0.0, 0, 0), (1.0, 1.0, 0, 0), (1.0, -0.5, 0, 0), (1.0, 0.5, 0, 0))
    z, y = np.zeros((4, 1)), np.array([[0.1], [0.1], [9.0], [0.1]])
    errors = np.asarray(member_errors(ensemble, z, y, np.array([True, True, False, True])))
    assert errors == pytest.approx([0.01, 0.81, 0.36, 0.16], rel=1e-5)
    assert select_elites(errors, 3).tolist() == [0, 3, 2]
    assert select_elites(np.array([1.0, 0.5, 1.0, 0.5]), 3).tolist() == [1, 3, 0]


def test_a_next_state_is_drawn_from_the_row_s_own_member():
    ensemble = affine((1.0, 0.0, 0, 0.5), (1.0, 10.0, 0, -1.0))
    z, noise = np.array([[1.0], [1.0], [2.0]]), np.array([[0.0], [2.0], [-1.0]])
    found = sample_next_states(ensemble, np.array([0, 1, 0]), z, noise)[:, 0]
    widths = np.exp(0.5 * bounded(np.array([0.5, -1.0, 0.5])))
    assert found == pytest.approx([1.0, 11.0 + 2 * widths[1], 2.0 - widths[2]], rel=1e-5)


@pytest.mark.costly
def test_training_finds_a_mean_and_a_variance_that_depends_on_the_place():
    """The data are y = sin 2z with noise of deviation 0.05 for z < 0 and 0.5 for z > 0."""
    rng = np.random.default_rng(0)
    z = rng.uniform(-1, 1, (2048, 1)).astype("f4")
    deviation = np.where(z > 0, 0.5, 0.05)
    y = (np.sin(2 * z) + deviation * rng.standard_normal(z.shape)).astype("f4")
    learner = begin_learner(np.random.default_rng(0), 3, 1, (32, 32), 1, 3e-3)
    starts = np.asarray(learner.ensemble.layers[0][0])
    assert not (starts[0] == starts[1]).any()
    rows = rng.integers(2048, size=(600, 3, 128))
    learner, losses = make_trainer(3e-3)(learner, z, y, rows)
    assert np.mean(losses[-20:]) < np.mean(losses[:20]) - 2
    at = np.broadcast_to(np.array([[-0.5], [0.5]], "f4"), (3, 2, 1))
    mean, log_var = predict_gaussians(learner.ensemble, at)
    assert np.asarray(mean)[:, 0, 0] == pytest.approx(np.full(3, np.sin(-1)), abs=0.1)
    found = np.exp(0.5 * np.asarray(log_var)).mean(axis=0)[:, 0]
    assert found == pytest.approx([0.05, 0.5], rel=0.4)
    again, _ = make_trainer(3e-3)(begin_learner(np.random.default_rng(0), 3, 1, (32, 32), 1, 3e-3), z, y, rows)
    assert (np.asarray(again.ensemble.max_log_variance) == np.asarray(learner.ensemble.max_log_variance)).all()
