"""Merged moments equal those of all samples together."""

from __future__ import annotations

import numpy as np
import pytest

from dynamics.batch.rolling import Moments, merge_chunks


def moments_of(values: np.ndarray) -> Moments:
    mean = values.mean(axis=0)
    return Moments(len(values), mean, ((values - mean) ** 2).sum(axis=0))


@pytest.mark.parametrize("bounds", [[], [10], [3, 4, 50], [0, 0, 100], [1, 2, 3, 4, 5, 6]])
def test_merged_chunks_are_the_moments_of_all(bounds):
    values = 1e6 + np.random.default_rng(0).standard_normal((100, 3))
    chunks = [moments_of(c) if len(c) else Moments(0, *np.zeros((2, 3))) for c in np.split(values, bounds)]
    whole = moments_of(values)
    table = (
        np.array([c.n for c in chunks]),
        *(np.array(a) for a in zip(*((c.mean, c.m2) for c in chunks), strict=True)),
    )
    for merged in (merge_chunks(*table), sum_of(chunks)):
        assert merged.n == 100
        np.testing.assert_allclose(merged.mean, whole.mean, rtol=1e-15)
        np.testing.assert_allclose(merged.variance, values.var(axis=0, ddof=1), rtol=1e-9)
        np.testing.assert_allclose(merged.standard_error**2 * 100, merged.variance)


def sum_of(chunks: list[Moments]) -> Moments:
    total = chunks[0]
    for chunk in chunks[1:]:
        total = total.merge_with(chunk)
    return total


def test_no_chunks_are_no_samples():
    assert merge_chunks(np.zeros(0), np.zeros((0, 2)), np.zeros((0, 2))).n == 0


def test_one_sample_has_no_variance():
    with pytest.raises(ValueError, match="needs at least 2 finite samples, there are 1"):
        _ = Moments(1, np.zeros(2), np.zeros(2)).variance
