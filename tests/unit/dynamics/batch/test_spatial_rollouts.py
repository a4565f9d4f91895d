"""Rollouts of a machine in space: backends agree, and gradients equal differences."""

from __future__ import annotations

import numpy as np
import pytest

from tests.benchmarks.robots.ants import draws, rollouts

MU, SAMPLES, STEP = 1e-2, 3, 1e-5


@pytest.fixture(scope="module")
def by_casadi():
    f = rollouts(MU, "casadi")
    return f, f(*draws(SAMPLES))


@pytest.mark.costly
@pytest.mark.parametrize("backend", ["c", "numpy"])
def test_engines_agree_on_the_ant(backend, by_casadi) -> None:
    expected = by_casadi[1]
    assert not expected.nonfinite
    found = rollouts(MU, backend)(*draws(SAMPLES))
    np.testing.assert_allclose(found.cost, expected.cost, rtol=1e-9, atol=1e-9)
    scale = np.abs(expected.gradient).max()
    np.testing.assert_allclose(found.gradient, expected.gradient, rtol=0, atol=1e-9 * scale)


@pytest.mark.costly
def test_gradients_of_the_ant_are_differences(by_casadi) -> None:
    f, expected = by_casadi
    start, inputs = (each[:1] for each in draws(SAMPLES))
    ways = np.random.default_rng(1).standard_normal((6, *inputs.shape[1:]))
    there, back = (f(start, inputs + s * STEP * ways, gradient=False).cost for s in (1, -1))
    slopes = np.tensordot(ways, expected.gradient[0], 2)
    np.testing.assert_allclose((there - back) / (2 * STEP), slopes, rtol=1e-6, atol=1e-8)
