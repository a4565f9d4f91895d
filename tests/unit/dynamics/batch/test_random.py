"""Counter-based normals: known answers, statistics, streams, and the compiled version."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from dynamics.batch import Gaussian
from dynamics.batch.random import key_of, philox, standard_normals
from tests.unit.dynamics.batch.c_draws import draw, transform

# Known answers of Random123, Philox4x32-10.
KNOWN = [
    (
        (0, 0, 0, 0),
        (0, 0),
        (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8),
    ),
    (
        (0xFFFFFFFF, 0xFFFFFFFF, 0xFFFFFFFF, 0xFFFFFFFF),
        (0xFFFFFFFF, 0xFFFFFFFF),
        (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD),
    ),
    (
        (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344),
        (0xA4093822, 0x299F31D0),
        (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1),
    ),
]


@pytest.mark.parametrize(("counter", "key", "words"), KNOWN)
def test_known_answers(counter, key, words):
    assert tuple(int(w) for w in philox(np.array(counter, dtype=np.uint64), key)) == words


def test_statistics_are_those_of_numpys_normals():
    n = 400_000
    ours = standard_normals(key_of(11), 0, n // 8, 8).ravel()
    theirs = np.random.default_rng(11).standard_normal(n)
    for power, variance in ((1, 1), (2, 2), (3, 15), (4, 96), (6, 10170)):
        assert abs(np.mean(ours**power) - stats.norm.moment(power)) < 5 * np.sqrt(variance / n)
    assert stats.kstest(ours, "norm").pvalue > 1e-3
    assert stats.ks_2samp(ours, theirs).pvalue > 1e-3
    columns = ours.reshape(-1, 8)
    correlation = np.corrcoef(columns.T) - np.eye(8)
    assert np.abs(correlation).max() < 5 / np.sqrt(len(columns))
    assert abs(np.corrcoef(columns[:-1, 0], columns[1:, 0])[0, 1]) < 5 / np.sqrt(len(columns))


def words_and_normals(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Return words (2, n) that include the ends of both ranges, and their normals in long double."""
    words = np.random.default_rng(2).integers(0, 2**32, (2, n), dtype=np.uint64)
    ends = np.array([0, 1, 2, 2**31 - 1, 2**31, 2**31 + 1, 2**32 - 2, 2**32 - 1], dtype=np.uint64)
    words[0, :64], words[1, :64] = np.repeat(ends, 8), np.tile(ends, 8)
    radius = np.sqrt(-2 * np.log((words[0] + np.longdouble(0.5)) / 2**32))
    angle = words[1] * (2 * np.longdouble("3.14159265358979323846264338327950288") / 2**32)
    return words, radius * np.stack((np.cos(angle), np.sin(angle)))


def test_the_kernel_transforms_words_to_within_two_roundings():
    """For radii from 1e-5 to 6.76 in every quadrant each normal is within 4e-16 of its radius."""
    words, wanted = words_and_normals(1 << 16)
    got = transform(words)
    radius = np.sqrt((wanted**2).sum(axis=0))
    assert radius.max() > 6.76
    assert radius.min() < 2e-5
    assert np.abs((got - wanted) / radius).max() < 5e-16


def test_the_tail_is_there():
    """P(|z| > x), summed over all 2**32 equally likely radii, agrees with the normal distribution.

    Beyond x = 6 there are a few dozen radii; over the angles P(|cos| > x/r) = (2/pi) acos(x/r).
    """
    for x, within in ((4.0, 1e-5), (5.0, 1e-4), (6.0, 0.02)):
        radius = np.sqrt(-2.0 * np.log((np.arange(2**32 * np.exp(-(x**2) / 2)) + 0.5) / 2**32))
        mass = np.sum(np.arccos(np.minimum(x / radius, 1.0))) * 2 / np.pi / 2**32
        assert abs(mass / (2 * stats.norm.sf(x)) - 1) < within


@pytest.mark.costly
def test_many_draws_of_the_kernel_are_normal():
    """A few 1e7 numbers have the right counts in cells of equal weight, moments, pairs, and tails."""
    size, cells = 1 << 18, 4096
    edges = stats.norm.ppf(np.arange(1, cells) / cells)
    counts, beyond, sums = np.zeros(cells), np.zeros(3), np.zeros(3)
    n, levels = 0, (4.0, 4.5, 5.0)
    pairs = np.zeros(256)
    for k in range(16):
        z = draw(21, 8 * k, size)
        n += z.size
        beyond += [np.count_nonzero(np.abs(z) > x) for x in levels]
        sums += [np.sum(z), np.sum(z**2), np.sum(z**4)]
        if k < 2:
            counts += np.bincount(np.searchsorted(edges, z.ravel()), minlength=cells)
            at = np.searchsorted(edges[255::256], z)
            pairs += np.bincount((16 * at[:, ::2] + at[:, 1::2]).ravel(), minlength=256)
    assert stats.chisquare(counts).pvalue > 1e-3
    assert stats.chisquare(pairs).pvalue > 1e-3
    for total, mean, variance in zip(sums, (0, 1, 3), (1, 2, 96), strict=True):
        assert abs(total / n - mean) < 4 * np.sqrt(variance / n)
    for found, x in zip(beyond, levels, strict=True):
        expected = n * 2 * stats.norm.sf(x)
        assert abs(found - expected) < 4 * np.sqrt(expected)


def test_first_samples_of_a_larger_run_are_the_same():
    long = Gaussian(0.5, seed=4).draw(100, 7, 3)
    np.testing.assert_array_equal(long[:10], Gaussian(0.5, seed=4).draw(10, 7, 3))
    np.testing.assert_array_equal(long[40:60], Gaussian(0.5, seed=4, first=40).draw(20, 7, 3))
    np.testing.assert_array_equal(long[:, :4], Gaussian(0.5, seed=4).draw(100, 4, 3))


def test_a_stream_goes_on_and_turns_round():
    noise = Gaussian(np.array([0.5, 3.0]), seed=4, first=7)
    np.testing.assert_array_equal(noise.negate().draw(20, 5, 2), -noise.draw(20, 5, 2))
    np.testing.assert_array_equal(noise.skip_samples(6).draw(4, 5, 2), noise.draw(10, 5, 2)[6:])
    later = noise.negate().skip_samples(6)
    np.testing.assert_array_equal(later.draw(4, 5, 2), -noise.draw(10, 5, 2)[6:])
    np.testing.assert_array_equal(later.negate().draw(4, 5, 2), noise.draw(10, 5, 2)[6:])


def test_samples_beyond_32_bits_have_streams_of_their_own():
    here, there = standard_normals(key_of(0), 5, 1, 6), standard_normals(key_of(0), 5 + 2**32, 1, 6)
    assert not np.any(here == there)


def test_seeds_are_streams():
    one = np.random.SeedSequence(3)
    np.testing.assert_array_equal(standard_normals(key_of(3), 0, 5, 2), standard_normals(key_of(one), 0, 5, 2))
    assert key_of(one.spawn(1)[0]) != key_of(3)


@pytest.mark.parametrize("sigma", [0.0, -1.0, np.nan, np.inf, [1.0, 0.0]])
def test_sigma_must_be_positive(sigma):
    with pytest.raises(ValueError, match="sigma must be positive and finite"):
        Gaussian(np.array(sigma), seed=0)


@pytest.mark.parametrize("seed", [-1, 1.5, "a", None, True])
def test_seed_must_be_a_whole_number(seed):
    with pytest.raises(ValueError, match="seed must be a whole number of at least 0"):
        Gaussian(1.0, seed=seed)
