"""One step of many samples: all backends agree with the step's own solver."""

from __future__ import annotations

import numpy as np
import pytest

from dynamics.batch import StepFunction
from problems import get
from tests.unit.dynamics.batch.backends import BACKENDS

CASES = {
    "push-1d": ([0.0, -0.3], [0.3, 0.2]),
    "planar-push": ([0.0, 0.5, 0.0, 0.0, -0.15], [0.1, 0.1, 0.3, 0.3, 0.05]),
    "box-slide": None,
}


def samples(name: str, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Return n states and inputs near a problem's start, many of them in contact."""
    problem, rng = get(name), np.random.default_rng(3)
    system = problem.system
    x0 = np.array(problem.limits(problem.parameters.values)[0]).ravel()
    centre, spread = CASES[name] or (x0, np.full(system.nx, 0.3))
    x = np.asarray(centre) + np.asarray(spread) * rng.standard_normal((n, system.nx))
    return x, 0.3 * rng.standard_normal((n, system.nu))


@pytest.mark.cheap_cases("push-1d-c", "push-1d-numpy", "push-1d-casadi", "box-slide-casadi")
@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("name", CASES)
def test_a_step_of_many_is_the_step_of_each(name: str, backend: str) -> None:
    step = get(name).exact_step
    x, u = samples(name, 150)
    got = StepFunction(step, backend)(x, u)
    p = step.p.values
    solved = [step.solve(*pair, p) for pair in zip(x, u, strict=True)]
    wanted = np.array([np.array(found[0]).ravel() for found in solved])
    assert max(np.array(found[3]).max() for found in solved) < 1e-7
    np.testing.assert_allclose(got.x_next, wanted, rtol=0, atol=1e-10)
    assert not got.nonfinite and (got.lam > 1e-6).any()


def test_threads_and_blocks_change_no_bit() -> None:
    step = get("planar-push").exact_step
    x, u = samples("planar-push", 3001)
    one = StepFunction(step, threads=1, block=8)(x, u)
    many = StepFunction(step, threads=3)(x, u)
    assert np.array_equal(one.x_next, many.x_next) and np.array_equal(one.lam, many.lam)


def test_parameters_may_be_each_sample_s_own() -> None:
    step = get("push-1d").exact_step
    x, u = np.array([0.0, -0.25]), np.array([0.5])
    p = np.stack([step.p.pack({"M": M}) for M in (0.5, 1.0, 4.0)])
    got = StepFunction(step)(x, u, p).x_next[:, 0]
    # qu+ = qu + rho (u - (qu - width)) with rho = h²K / (M + h²K), noising eq. 13 by hand.
    stiffness = 0.1**2 * 100.0
    wanted = [stiffness / (M + stiffness) * (0.5 + 0.2) for M in (0.5, 1.0, 4.0)]
    np.testing.assert_allclose(got, wanted, rtol=1e-12)


@pytest.mark.parametrize("backend", BACKENDS)
def test_what_has_no_number_is_named(backend: str) -> None:
    x = np.array([[0.0, -0.5], [np.nan, -0.5]])
    got = StepFunction(get("push-1d").exact_step, backend)(x, [0.1])
    assert got.nonfinite.indices.tolist() == [1] and np.isfinite(got.x_next[0]).all()


def test_shapes_that_do_not_fit_are_told() -> None:
    with pytest.raises(ValueError, match="input 'u' of the step has 2 along axis 0, expected 1"):
        StepFunction(get("push-1d").exact_step)(np.zeros(2), np.zeros(2))


@pytest.mark.cheap_cases("push-1d-c", "push-1d-numpy", "push-1d-casadi", "planar-push-numpy")
@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("name", ["push-1d", "planar-push"])
def test_slopes_are_those_of_differences(name: str, backend: str) -> None:
    """They agree away from states at which a contact opens, where the exact step has a kink."""
    step, e = get(name).exact_step, 1e-6
    x, u = samples(name, 100)
    f = StepFunction(step, backend)
    steps, by_x, by_u = f.derivatives(x, u)
    assert np.array_equal(steps.x_next, f(x, u).x_next)
    for array, slopes in ((x, by_x), (u, by_u)):
        for i, moved in enumerate(e * np.eye(array.shape[1])):
            pair = [(x + s * moved, u) if array is x else (x, u + s * moved) for s in (1, -1)]
            up, down = (f(*at).x_next for at in pair)
            off = np.abs((up - down) / (2 * e) - slopes[:, :, i]).max(axis=1)
            assert np.mean(off < 1e-6) >= 0.98
