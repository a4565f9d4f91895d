"""Physical parameters psi from transitions: the loss, bootstrap intervals, and parameters that are not identifiable."""

from __future__ import annotations

import numpy as np
import pytest

from ocp.errors import InputError
from ocp.learning.explorer import Buffer
from ocp.learning.identify import OneStepLoss, bootstrap_intervals, identify
from ocp.search.random_search import RandomSearch
from tests.unit.ocp.learning.spring_mass import (
    NAMES,
    D,
    H,
    K,
    M,
    exact_step,
    following,
    transitions,
)

TRUE = np.array([M, K, D])
START = np.log([0.6 * M, 1.8 * K, 0.5 * D])


def in_contact(buffer: Buffer) -> np.ndarray:
    return buffer.x_next[:, 0] <= 1e-9


def test_the_loss_is_that_of_the_closed_form():
    """The loss is eq. 4.1 with a scale for each coordinate, for steps with and without contact."""
    buffer, scale = transitions(200), np.array([0.1, 3.0])
    assert 10 < in_contact(buffer).sum() < 190
    psi = np.array([[M, K, D], [1.3, 44.0, 0.2], [3.0, 10.0, 5.0]])
    off = [(following(buffer.x, buffer.u, *row) - buffer.x_next) / scale for row in psi]
    found = OneStepLoss(exact_step(), NAMES, scale=scale)(np.log(psi), buffer)
    assert found == pytest.approx([0.5 * np.sum(each**2) for each in off], rel=1e-6, abs=1e-12)
    assert found[0] < 1e-10 * found[1]


def test_what_is_not_learned_has_the_values_given_and_threads_change_nothing():
    buffer = transitions(100)
    one, two = (OneStepLoss(exact_step(), ["d"], values={"k": 12.0, "d": 7.0}, threads=n) for n in (1, 2))
    assert np.exp(one.start()) == pytest.approx([7.0])
    log_psi = np.log([[2.0], [3.0]])
    expected = following(buffer.x, buffer.u, M, 12.0, 3.0) - buffer.x_next
    assert one.errors(log_psi, buffer)[1] == pytest.approx(expected, abs=1e-7)
    assert (one(log_psi, buffer) == two(log_psi, buffer)).all()


def test_psi_is_found_where_linear_least_squares_finds_it():
    """Free steps satisfy ``m (v+ - v) + h k x + h d v+ = h u``, which is linear in psi."""
    buffer = transitions(400)
    free = buffer[~in_contact(buffer)]
    rows = np.stack([free.x_next[:, 1] - free.x[:, 1], H * free.x[:, 0], H * free.x_next[:, 1]], 1)
    linear = np.linalg.lstsq(rows, H * free.u[:, 0])[0]
    found = identify(OneStepLoss(exact_step(), NAMES), buffer, START, rows=64, seed=3)
    assert linear == pytest.approx(TRUE, rel=1e-8)
    assert found.values == pytest.approx(linear, rel=1e-3)
    assert found.loss < 1e-6 * found.start_loss
    assert len(found.model_params) < 301 and found.spread[-1].max() <= RandomSearch().narrow


def test_the_same_seed_gives_the_same_bits_and_another_gives_others():
    buffer, loss = transitions(100), OneStepLoss(exact_step(), NAMES)
    search = RandomSearch(iterations=5, passes=1)
    runs = [identify(loss, buffer, START, search, seed, rows=20) for seed in (1, 1, 2)]
    assert (runs[0].model_params == runs[1].model_params).all()
    assert not (runs[0].model_params[1] == runs[2].model_params[1]).any()


def test_the_second_pass_begins_where_the_first_ended_as_wide_as_the_model_is_insensitive():
    buffer, loss = transitions(100), OneStepLoss(exact_step(), NAMES)
    search = RandomSearch(iterations=3, width=0.2)
    found = identify(loss, buffer, START, search, rows=100)
    assert found.model_params.shape == (8, 3) and (found.model_params[4] == found.model_params[3]).all()
    log_psi = np.log(found.model_params[3])
    moves = loss.sensitivity(log_psi, 0.2, buffer)
    assert found.spread[4] == pytest.approx(0.2 * moves.min() / moves)

    def moved(shift: np.ndarray) -> float:
        ends = [following(buffer.x, buffer.u, *np.exp(log_psi + s)) for s in (shift, 0 * shift)]
        return float(np.sqrt(0.5 * np.mean(np.sum((ends[0] - ends[1]) ** 2, axis=1))))

    least = [min(moved(0.2 * e), moved(-0.2 * e)) for e in np.eye(3)]
    assert moves == pytest.approx(least, rel=1e-6)


def test_steps_that_are_not_solved_count_as_the_mean_of_the_others(monkeypatch):
    buffer, loss = transitions(100), OneStepLoss(exact_step(), NAMES)
    log_psi = np.log([[1.5, 20.0, 3.0]])
    errors = loss.errors(log_psi, buffer)
    for lost, factor in ((30, 100 / 70), (51, np.inf)):
        broken = errors.copy()
        broken[0, :lost, 1] = np.nan
        monkeypatch.setattr(loss, "errors", lambda *_, broken=broken: broken)
        expected = factor * 0.5 * np.sum(errors[0, lost:] ** 2)
        assert loss(log_psi, buffer) == pytest.approx([expected])


def test_psi_stays_within_reach_of_its_start():
    buffer, loss = transitions(60), OneStepLoss(exact_step(), ["k"])
    search = RandomSearch(iterations=20, reach=np.log(1.5))
    found = identify(loss, buffer, np.log([2 * K]), search, rows=60)
    assert found.values == pytest.approx([2 * K / 1.5], rel=1e-3)
    with pytest.raises(InputError, match="reach must be at least the width"):
        RandomSearch(reach=0.1)


def test_without_input_only_ratios_are_known():
    """Without force, a multiple of ``(m, k, d)`` gives the same motion, so that the scale of psi is unknown."""
    buffer = transitions(300, force=0.0)
    loss = OneStepLoss(exact_step(), NAMES)
    found = bootstrap_intervals(loss, np.log(TRUE), buffer)
    sizes, directions = np.linalg.eigh(found.information)
    assert np.abs(directions[:, 0]) == pytest.approx(np.full(3, 3**-0.5), abs=1e-6)
    assert sizes[0] < 1e-10 * sizes[-1]
    assert (found.low == 0).all() and np.isinf(found.high).all()
    ratios = bootstrap_intervals(OneStepLoss(exact_step(), ["k", "d"]), np.log(TRUE[1:]), buffer)
    assert np.isfinite(ratios.high).all()


def test_the_information_is_that_of_the_closed_form():
    """For k, ``dv+/d log k = -h k x / (m + h d)`` in free steps and 0 in contact; dx+ is h dv+."""
    buffer = transitions(300)
    slope = np.where(in_contact(buffer), 0.0, -H * K * buffer.x[:, 0] / (M + H * D))
    found = bootstrap_intervals(OneStepLoss(exact_step(), ["k"]), np.log([K]), buffer)
    assert found.information[0, 0] == pytest.approx((1 + H**2) * np.mean(slope**2), rel=1e-5)


@pytest.mark.costly
def test_intervals_of_noisy_data_are_those_of_the_sandwich_and_hold_the_truth():
    """Near the minimum ``log k`` has the sandwich variance ``sum J²r² / (sum J²)²``."""
    sigma, covered, n = 0.05, 0, 20
    loss = OneStepLoss(exact_step(), ["k"], scale=np.array([1e6, 1.0]))
    for seed in range(n):
        buffer = transitions(300, seed=seed, noise=sigma)
        buffer = buffer[buffer.x[:, 0] + H * buffer.x[:, 1] > 0.1]
        J = -H * K * buffer.x[:, 0] / (M + H * D)
        r = following(buffer.x, buffer.u, M, K, D)[:, 1] - buffer.x_next[:, 1]
        at = np.log(K) - np.sum(J * r) / np.sum(J**2)
        found = bootstrap_intervals(loss, np.array([at]), buffer, seed=seed)
        width = np.log(found.high[0] / found.low[0])
        assert width == pytest.approx(2 * 1.96 * np.sqrt(np.sum((J * r) ** 2)) / np.sum(J**2), rel=0.2)
        covered += bool(found.low[0] <= K <= found.high[0])
    assert covered >= 16


def test_intervals_of_exact_data_reach_from_what_was_found_to_the_truth():
    loss = OneStepLoss(exact_step(), NAMES)
    found = bootstrap_intervals(loss, np.log(1.003 * TRUE), transitions(300))
    assert found.high == pytest.approx(1.003 * TRUE, rel=1e-12)
    assert found.low == pytest.approx(TRUE, rel=2e-5)


@pytest.mark.parametrize(
    ("names", "values", "message"),
    [
        (["mass"], {}, "spring-mass has no parameter 'mass'"),
        ([], {}, "name each parameter to learn once, got none"),
        (["k", "k"], {}, "name each parameter to learn once, got k, k"),
        (["rest"], {}, "rest is learned by its logarithm, so it must start positive, got 0"),
        (["k"], {"k": -1.0}, "k is learned by its logarithm"),
    ],
)
def test_bad_names_and_values_are_told(names, values, message):
    with pytest.raises(InputError, match=message):
        OneStepLoss(exact_step(), names).start(values)


def test_bad_data_and_settings_are_told():
    x, u = np.zeros((3, 2)), np.zeros((3, 1))
    loss = OneStepLoss(exact_step(), NAMES)
    with pytest.raises(InputError, match="1 of 3 are not finite; leave them out"):
        Buffer(x, np.array([[0.0], [np.nan], [0.0]]), x)
    with pytest.raises(InputError, match="3 states and 2 inputs"):
        Buffer(x, u[:2], x)
    with pytest.raises(InputError, match="expected \\(n, nx\\)"):
        Buffer(x, u, x[:, :1])
    with pytest.raises(InputError, match="got 0, 128 at a time"):
        identify(loss, Buffer(x[:0], u[:0], x[:0]), START)
    with pytest.raises(InputError, match="scales of errors must be positive"):
        OneStepLoss(exact_step(), NAMES, scale=np.array([1.0, 0.0]))
    with pytest.raises(InputError, match="candidates must be a whole number >= 4, got 2"):
        RandomSearch(candidates=2)
    with pytest.raises(InputError, match="the final width of a random search must be below"):
        RandomSearch(width=1e-3, narrow=1e-2)


def test_a_buffer_keeps_the_newest_and_leaves_out_what_was_not_solved():
    def rows(*numbers: float) -> Buffer:
        column = np.array(numbers)[:, None]
        return Buffer(column, 10 * column, 100 * column)

    both = rows(1, 2, 3).with_newest(rows(4, 5), capacity=4)
    assert (both.x[:, 0] == [2, 3, 4, 5]).all() and (both.x_next[:, 0] == 100 * both.x[:, 0]).all()
    x = np.ones((2, 1))
    assert len(Buffer.from_solved_steps(x, x, np.array([[1.0], [np.nan]]))) == 1
