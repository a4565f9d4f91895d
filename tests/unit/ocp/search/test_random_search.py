"""The random search agrees with its recursion by hand, and minimises difficult functions."""

from __future__ import annotations

import numpy as np
import pytest

from ocp.search.random_search import RandomSearch


def test_one_step_is_that_of_the_tutorial_by_hand():
    """With four candidates in one dimension all numbers equal the formulas of Hansen's tutorial on CMA-ES."""
    search = RandomSearch(candidates=4, width=0.5)
    first, second = np.log(2.5), np.log(2.5) - np.log(2)
    w = np.array([first, second]) / (first + second)
    assert search.weights == pytest.approx(w)
    rng = np.random.default_rng(7)
    drawn = np.random.default_rng(7).standard_normal(4)
    found = search.iterate(search.begin(np.array([1.0])), lambda z: (z[:, 0] - 3) ** 2, rng)
    best = np.argsort((1 + 0.5 * drawn - 3) ** 2)[:2]
    step = w @ drawn[best]
    mass = 1 / (w @ w)
    c_s = (mass + 2) / (1 + mass + 5)
    c_c = (4 + mass) / (5 + 2 * mass)
    c_1 = 2 / (2.3**2 + mass)
    c_mu = min(1 - c_1, 2 * (mass - 2 + 1 / mass) / (9 + mass))
    expected = 1 - 1 / 4 + 1 / 21
    p_sigma = np.sqrt(c_s * (2 - c_s) * mass) * step
    assert abs(p_sigma) / np.sqrt(1 - (1 - c_s) ** 2) < (1.4 + 1) * expected
    p_c = np.sqrt(c_c * (2 - c_c) * mass) * step
    assert found.mean == pytest.approx([1 + 0.5 * step]) and found.centre == [1.0]
    assert found.p_sigma == pytest.approx([p_sigma])
    assert found.p_c == pytest.approx([p_c])
    C = 1 - c_1 - c_mu + c_1 * p_c**2 + c_mu * (w @ drawn[best] ** 2)
    assert found.C[0, 0] == pytest.approx(C)
    damping = 1 + 2 * max(0.0, np.sqrt((mass - 1) / 2) - 1) + c_s
    sigma = 0.5 * np.exp(c_s / damping * (abs(p_sigma) / expected - 1))
    assert found.sigma == pytest.approx(sigma)
    assert search.deviations(found) == pytest.approx([sigma * np.sqrt(C)])


def test_a_turned_valley_is_followed_to_its_end():
    """It minimises a rotated quadratic of condition 1e6 and Rosenbrock's function."""
    axes = np.linalg.qr(np.random.default_rng(0).standard_normal((6, 6)))[0]
    scales = np.logspace(0, 3, 6)
    search = RandomSearch(iterations=600, narrow=1e-10)

    def quadratic(z):
        return np.sum(((z - 1) @ axes * scales) ** 2, axis=1)

    def rosenbrock(z):
        return np.sum(100 * (z[:, 1:] - z[:, :-1] ** 2) ** 2 + (1 - z[:, :-1]) ** 2, axis=1)

    for losses in (quadratic, rosenbrock):
        distribution = search.begin(np.zeros(6))
        while not search.is_done(distribution):
            rng = np.random.default_rng([5, int(distribution.count)])
            distribution = search.iterate(distribution, losses, rng)
        assert distribution.mean == pytest.approx(np.ones(6), abs=1e-6)
        assert distribution.count < 600


def test_candidates_without_a_number_are_the_worst():
    search = RandomSearch(candidates=8)
    found = search.iterate(
        search.begin(np.zeros(2)),
        lambda z: np.where(z[:, 0] > 0, np.nan, np.sum(z**2, axis=1)),
        np.random.default_rng(0),
    )
    drawn = np.random.default_rng(0).standard_normal((8, 2))
    assert (drawn[:, 0] < 0).sum() >= 4
    assert found.mean[0] < 0


def test_widths_go_against_the_sensitivity_that_is_known():
    search = RandomSearch(width=0.2)
    found = search.begin(np.zeros(4), np.array([0.1, 0.4, np.inf, 0.2]))
    assert search.deviations(found) == pytest.approx([0.2, 0.05, 0.05, 0.1])
    nothing = search.begin(np.zeros(2), np.array([np.inf, np.inf]))
    assert search.deviations(nothing) == pytest.approx([0.2, 0.2])
