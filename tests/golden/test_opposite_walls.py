"""A machine between two opposite walls, whose gaps differ only by sign and a constant."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import brentq

from dynamics.contact import Exact
from dynamics.contact.path import Path as Follower
from dynamics.contact.reduced_path import ReducedPath, path_of
from ocp.problem.problem import Problem
from problems.registry import load

EXAMPLE = Path(__file__).parents[2] / "examples" / "double_pendulum_walls.py"


@cache
def problem() -> Problem:
    return load(EXAMPLE).problem({"friction": 0.0, "wall": 0.6})


def states(count: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Draw pairs of a state with a ball up to 6 cm from a wall, and an input."""
    rng, found = np.random.default_rng(0), []
    distance = problem().signed_distance
    assert distance is not None
    while len(found) < count:
        x = np.concatenate([rng.uniform(-3, 3, 2), 4 * rng.normal(size=2)])
        phi = np.array(distance(x, problem().parameters.values))
        if 0 <= phi.min() < 0.06:
            found.append((x, rng.uniform(-4, 4, 2)))
    return found


def slopes(path: Follower, data: np.ndarray, lam: np.ndarray) -> np.ndarray:
    symbols = ca.SX.sym("lam", path.n)
    told = ca.Function("told", [symbols, path.data], [*map(ca.densify, path.true_gap_at(symbols))])
    ways = 1e-6 * np.eye(path.n)
    rises = [told(lam + way, data)[0] - told(lam - way, data)[0] for way in ways]
    rise = np.array(ca.horzcat(*rises)) / 2e-6
    np.testing.assert_allclose(np.array(told(lam, data)[1]), rise, atol=1e-6)
    return rise


def test_gaps_of_walls_that_face_each_other_give_way_oppositely() -> None:
    """The path's derivatives equal differences, with and without its factors."""
    s = problem().system
    mu = ca.SX.sym("mu", s.nlam)
    given = [s.x, s.u, s.parameters.vector, mu]
    (x, u), lam = states(1)[0], np.linspace(0.1, 1.0, s.nlam)
    found = path_of(s, True)
    assert isinstance(found, ReducedPath)
    scales = []
    for path in (found, Follower.of_system(s, True)):
        opening = ca.Function("opening", given, [path.opening_data_of(s, mu)])
        data = np.array(opening(x, u, s.parameters.values, 0))
        rise = slopes(path, data, lam)
        scale = np.array(ca.Function("D", [path.data], [path.data_parts["D"]])(data)).ravel()
        own = rise / np.outer(scale, scale)
        np.testing.assert_allclose(own[[0, 2]], -own[[1, 3]], atol=1e-6)
        assert np.abs(own[:4, :4]).min() > 1e-3
        scales.append(scale)
    # Slip pairs have no compliance of their own: their scale follows from the pairs to which F couples them.
    compliant = [i for i, pair in enumerate(s.pairs) if pair.kind != "slip"]
    np.testing.assert_allclose(scales[0][compliant], scales[1][compliant])


@pytest.mark.costly
def test_every_step_is_solved_and_is_the_root_of_its_one_gap() -> None:
    """If one ball touches one wall, its impulse is the root of a scalar function."""
    s, step = problem().system, Exact().close(problem().system)
    p = step.p.values
    landed = ca.Function("landed", [s.x, s.u, s.lam, s.parameters.vector], [s.x_next_expr])
    distance, met = problem().signed_distance, 0
    assert distance is not None
    for x, u in states(200):
        x_next, lam, gap, error = (np.array(v).ravel() for v in step.solve(x, u, p))
        assert error.max() < 1e-9 and lam.min() >= 0 and gap[:4].min() > -1e-9
        pushed = np.flatnonzero(lam[:4] > 1e-6)
        # A path with friction that ends before mu = 0 leaves a positive product instead of a root.
        if len(pushed) != 1 or np.max(lam * gap) > 1e-9:
            continue
        i = int(pushed[0])

        def opened(impulse: float, x=x, u=u, i=i) -> float:
            along = np.zeros(s.nlam)
            along[i] = impulse
            return float(distance(landed(x, u, along, p), p)[i])

        if opened(0.0) > 0:  # a curved gap may have another solution, without contact
            continue
        met += 1
        ends = 0.5 * lam[i], 1.5 * lam[i]
        assert lam[i] == pytest.approx(brentq(opened, *ends, xtol=1e-13), rel=1e-5)
        np.testing.assert_allclose(np.array(landed(x, u, lam, p)).ravel(), x_next, atol=1e-9)
    assert met >= 20
