"""Parts of study N2: the bundled dynamics in closed form, descents, and the drawing."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from scipy.stats import norm

from dynamics.contact import Exact
from problems import get, studies
from problems.studies.start_without_contact import data as n2
from problems.studies.start_without_contact.data import LAWS, PROBLEMS, label_plans
from problems.studies.start_without_contact.dynamics import (
    DYNAMICS,
    Bundle,
    Bundled,
    descend_gains,
    gains_of,
    replay_gains,
)
from problems.studies.study import FinishedParts
from reports.drawing.style import house_style
from reports.figures.studies import DRAWINGS


def test_the_bundle_of_a_pusher_is_its_closed_form():
    """The mean of ``q + rho max(0, u - q - l + noise)`` has the closed form of fig. 1."""
    problem = get("push-1d")
    p = problem.parameters.defaults
    rho = p["h"] ** 2 * p["K"] / (p["M"] + p["h"] ** 2 * p["K"])
    width, n = np.array([0.1, 0.05, 0.2]), 20_000
    z = np.array([[0.0, -0.3, u] for u in (-0.4, -0.2, 0.0, 0.3)])
    bundle = Bundle(problem.exact_step, width, n, seed=1)
    y, slopes = bundle.jacobians(z)
    s = float(np.hypot(width[0], width[2]))
    alone = Bundle(problem.exact_step, 1e-9 * width, 2, seed=0).values(z)[:, 0]
    m = np.where(alone > 1e-6, alone / rho, np.nan)
    offset = np.nanmedian(m - z[:, 2])
    m = z[:, 2] + offset
    mean = rho * (m * norm.cdf(m / s) + s * norm.pdf(m / s))
    error = 5 * (width[0] + rho * s) / np.sqrt(n)
    assert np.abs(y[:, 0] - mean).max() < error
    assert np.abs(slopes[:, 0, 2] - rho * norm.cdf(m / s)).max() < 5 * rho / np.sqrt(n)
    with pytest.raises(NotImplementedError, match="cannot be differentiated again"):
        bundle.curvatures(z, y)


@pytest.mark.costly
def test_descents_with_and_without_a_gradient_at_the_start():
    """Without contact at the start the object's exact gradient is zero, and the bundled one is not (sec. V-B)."""
    problem = get("planar-push")
    stuck = descend_gains(problem, Exact(), 0.01, 20)
    assert stuck["exact"] == pytest.approx(stuck["model"], rel=1e-9)
    assert abs(1 - stuck["exact"][-1] / stuck["exact"][0]) < 1e-4
    width = 0.2 * np.array([0.44, 0.57, 1.3, 0.68, 0.66, 0.69, 0.67])
    moved = descend_gains(problem, Bundled(Bundle(problem.exact_step, width, 20, 0)), 0.01, 30)
    assert moved["exact"][-1] < 0.6 * moved["exact"][0]
    assert moved["states"].shape == (problem.N + 1, 5)
    rows = np.arange(problem.N * 12.0).reshape(problem.N, 12)
    gains = gains_of(problem, rows.ravel())
    assert np.array_equal(gains.K[3], rows[3, :10].reshape(2, 5))
    assert np.array_equal(gains.k[3], rows[3, 10:])
    held = gains_of(problem, np.concatenate([np.zeros(10), [0.0, -0.2]] * problem.N))
    assert replay_gains(problem, held) == pytest.approx(replay_gains(problem, held)[0][None].repeat(21, 0))


def drawn_up() -> xr.Dataset:
    """Return data of study N2 assembled by the study from synthetic parts."""
    rng = np.random.default_rng(0)
    shape = len(PROBLEMS), len(LAWS)

    class Made(FinishedParts):
        def get(self, key, make):
            if key == "plans":
                return {
                    "cost": 1 + rng.random((*shape, 3)),
                    "total": 1 + rng.random((*shape, 2)),
                    "iterations": np.ones(shape, int),
                    "status": np.full(shape, "solved"),
                    "path": rng.random((*shape, 2, 21, 3)),
                }
            if key.startswith("ipopt"):
                return {"costs": np.array([1.0, 2.0]), "iterations": np.array(7)}
            problem = get("planar-push" if "push" in key else "planar-hand")
            start = problem.initial_states(problem.parameters.values)
            records = {"model": 1 + rng.random(11), "exact": 1 + rng.random(11)}
            return {**records, "states": start.repeat(21, axis=0)}

    return n2.run(n2.Params(seeds=2, steps=100), Made())


@pytest.mark.costly
def test_every_piece_finds_its_place_in_data_claims_and_drawing():
    data = drawn_up()
    assert data["learned"].shape == (2, len(DYNAMICS), 2, 11, 2)
    assert np.isfinite(data["learned"]).all() and np.isfinite(data["final"]).all()
    assert label_plans.__module__ and set(data["law"].values) == set(LAWS)
    claims = studies.get("N2").claims(data)
    assert len(claims) == 24 and not all(claim.holds for claim in claims)
    with house_style():
        figure = DRAWINGS["N2"].draw(data)
    assert sum(axis.get_title() != "" for axis in figure.axes) == 18
