"""Functions of studies N0 and N1 agree with quadrature, enumeration and the workbench's step."""

from __future__ import annotations

import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm, truncnorm

from dynamics.contact import Exact
from dynamics.learned.transitions import Normalisation
from ocp.errors import InputError
from problems import get, studies
from problems.studies.noised_contact.data import sample_sets
from problems.studies.shared.noised_line import (
    LinePusher,
    Walls,
    average_of,
    model_values,
    network_of,
)
from problems.studies.shared.sampled_step import SampledStep
from problems.studies.theory_of_noising import data, lemmas
from reports.cli.app import main
from reports.drawing.style import house_style, to_svg
from reports.figures.studies import DRAWINGS

TINY = {
    "N0": {"epochs": 2, "repeats": 1, "n_samples": 400},
    "N1": {"epochs": 2, "networks": 1, "units": 4},
}


def test_the_pusher_is_the_exact_step_of_push_1d() -> None:
    problem = get("push-1d", M=1.0, K=500.0, h=0.05, qu0=0.5, qa0=0.0)
    u = np.linspace(-1, 1.5, 41)
    start = np.tile([0.5, 0.0], (len(u), 1))
    after = SampledStep(Exact().close(problem.system))(start, u[:, None], {"M": 1.0, "K": 500.0, "h": 0.05})
    pusher = LinePusher(1.25 / 2.25, q=0.5, c=0.3)
    assert after.x_next[:, 0] == pytest.approx(pusher.step(u), abs=1e-10)


@pytest.mark.parametrize("u", [-1.3, -0.2, 0.31, 0.9, 1.6])
def test_averages_of_the_pusher_are_those_of_quadrature(u: float) -> None:
    pusher, sigma = LinePusher(0.556, q=0.5, c=0.3), 0.2

    def bell(t: float) -> float:
        return float(norm.pdf(t, u, sigma))

    def mean(low: float, high: float) -> float:
        at = sorted({*np.clip([0.3, u], low, high)})
        whole = quad(bell, low, high, points=at, epsabs=1e-15)[0]
        part = quad(lambda t: bell(t) * float(pusher.step(t)), low, high, points=at, epsabs=1e-15)
        return part[0] / whole

    assert pusher.smoothed(u, sigma) == pytest.approx(mean(u - 2, u + 2), rel=1e-10)
    assert pusher.noised(u, sigma, -0.7, 1.3) == pytest.approx(mean(-0.7, 1.3), rel=1e-8)


@pytest.mark.parametrize("sigma", [0.05, 0.2, 1.0])
def test_the_block_is_the_truncated_normal(sigma: float) -> None:
    block, x = Walls(-0.5, 1.5), np.linspace(-1, 2, 301)
    a, b = (block.low - x) / sigma, (block.high - x) / sigma
    assert block.noised(x, sigma) == pytest.approx(truncnorm.mean(a, b, x, sigma), abs=1e-10)
    variance = np.asarray(truncnorm.var(a, b, x, sigma))
    assert block.slope(x, sigma) == pytest.approx(variance / sigma**2, abs=1e-8)


def test_far_in_a_wall_the_block_is_where_mills_ratio_says() -> None:
    block, far = Walls(), np.array([10.0, 1e3, 1e5])
    # Asymptotically 1 - g = sigma/s (1 - 2/s² + ...), and the slope is 1/s² (1 - 6/s² + ...).
    inside = 1 - block.noised(1 + 0.1 * far, 0.1)
    assert inside == pytest.approx(0.1 / far * (1 - 2 / far**2), rel=1e-3, abs=1e-11)
    assert block.slope(1 + 0.1 * far[:2], 0.1) == pytest.approx((1 - 6 / far[:2] ** 2) / far[:2] ** 2, rel=1e-2)
    assert block.displacement(0.0, 0.1) == 0
    assert block.noised(np.array([-1.3]), 0.1) == pytest.approx(-block.noised([1.3], 0.1))


def test_effective_neighbours_are_those_of_the_weights() -> None:
    rng = np.random.default_rng(0)
    z, queries, sigma = rng.standard_normal((300, 4)), rng.standard_normal((7, 4)), 0.7
    scale = np.array([1.0, 2.0, 0.5, 1.0])
    distance = (z[None] - queries[:, None]) / scale
    weight = np.exp(-0.5 * np.sum(distance**2, axis=2) / sigma**2)
    expected = weight.sum(axis=1) ** 2 / np.sum(weight**2, axis=1)
    found = data.effective_neighbours(z, Normalisation(np.ones(4), scale), sigma, queries)
    assert found == pytest.approx(expected, rel=1e-10)


@pytest.mark.costly
def test_lemmas_hold_and_what_is_no_minimum_is_seen() -> None:
    found = lemmas.noised_risks(0.7, 3)
    higher = found["higher"][1]
    assert higher.shape[:3] == (len(lemmas.CASES), len(lemmas.WIDTHS), len(lemmas.CHANGES))
    assert higher / lemmas.CHANGES[:, None] ** 2 == pytest.approx(1, abs=1e-9)
    error, law = (lemmas.uniform_data()[name][1] for name in ("sum_error", "sum_law"))
    assert (error / law)[..., -1] == pytest.approx(1, abs=0.01)
    # The risk of distant data is a sum over pairs, here by hand for two data.
    x, y, sigma = np.array([-0.1, 0.2]), np.array([0.0, 1.0]), 0.1
    z = np.arange(-1.5, 1.5, sigma / 8)
    joint = norm.pdf(z, x[:, None], sigma) * sigma / 16
    g = model_values(average_of(x, y, sigma), z)
    share = 1 / (1 + np.exp((x[0] - x[1]) * (z - x.mean()) / sigma**2))
    assert g == pytest.approx(share, abs=1e-12)
    assert np.sum(joint * (g - y[:, None]) ** 2) == pytest.approx(
        np.sum(joint.sum(axis=0) * share * (1 - share)), rel=1e-12
    )


@pytest.mark.costly
def test_sets_of_data_are_as_far_off_as_their_standard_errors() -> None:
    found = sample_sets(LinePusher(), 10, 1000, 5)
    assert found["score_square"][1].mean() == pytest.approx(1, abs=0.4)
    # The error sqrt(2/pi) rho sigma is many standard errors of the data within half a Gaussian.
    assert np.all(found["end_score"][1] < -5)
    assert np.all(found["least_inside"][1] > 0)


def test_rollouts_climb_the_density_and_stop_at_its_modes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lemmas, "SAMPLES", lemmas.SAMPLES[:3])
    found = lemmas.climb_density(0.3, 0)
    assert np.all(found["climb"][1] >= 0)
    few = np.random.default_rng([0, 3, 0]).uniform(-1, 1, int(lemmas.SAMPLES[0]))
    model, x = average_of(few, few, 0.3), np.linspace(-1, 1, 2001)
    density = model.values(x[:, None])[:, 1]
    modes = np.sum((density[1:-1] > density[:-2]) & (density[1:-1] > density[2:]))
    assert found["attractors"][1][0] == modes


@pytest.mark.costly
def test_a_network_learns_noise_in_metres() -> None:
    rng = np.random.default_rng(1)
    x = rng.uniform(-1, 1, 1000)
    h = network_of(x, x, 0.3, 0, hidden=(16, 16), epochs=400, batch=500, rate=1e-2, held_out=0.0)
    assert h.sigma * x.std() == pytest.approx(0.3)
    at = np.linspace(-1, 1, 21)
    # Without noise the map would be x itself, 0.24 away at the walls.
    assert model_values(h, at) == pytest.approx(Walls().noised(at, 0.3), abs=0.06)


@pytest.mark.costly
@pytest.mark.parametrize("identifier", list(TINY))
def test_data_carry_units_and_are_drawn(identifier: str, monkeypatch: pytest.MonkeyPatch) -> None:
    # An average replaces the networks, so that the drawing takes seconds.
    monkeypatch.setattr(data, "network_of", lambda z, y, *_, **__: average_of(z, y, 0.1))
    found = studies.get(identifier).data(TINY[identifier])
    assert all(variable.attrs.get("units") or variable.dtype.kind not in "fiu" for variable in found.variables.values())
    with house_style():
        figure = DRAWINGS[identifier].draw(found)
        assert len(to_svg(figure)) > 10_000
    labels = "".join(axis.get_ylabel() + axis.get_xlabel() for axis in figure.axes)
    assert "[m]" in labels
    study = studies.get(identifier)
    blank = found.map(lambda v: v * np.nan if v.dtype.kind in "fiu" else v, keep_attrs=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        told = study.claims(blank.assign_attrs(found.attrs))
    assert not [claim.claim for claim in told if claim.holds]


@pytest.mark.parametrize("identifier", list(TINY))
def test_without_the_extra_a_sentence_names_it(
    identifier: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:
    monkeypatch.setitem(sys.modules, "equinox", None)
    assert main(["figure", identifier, "--out", str(tmp_path)]) == 2
    told = capsys.readouterr().err
    assert "centralpath[learn]" in told and "defect" not in told
    with pytest.raises(InputError, match="this figure trains networks"):
        studies.get(identifier).data(TINY[identifier])
