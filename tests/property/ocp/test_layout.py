"""Named blocks in one vector are complete and do not overlap."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ocp.programs.layout import Layout
from tests.examples import settings

shapes = st.lists(st.lists(st.integers(0, 4), min_size=1, max_size=3).map(tuple), min_size=1, max_size=6)


def build(sizes: list[tuple[int, ...]]) -> Layout:
    layout = Layout()
    for i, shape in enumerate(sizes):
        layout.add(f"block{i}", shape)
    return layout


@settings(max_examples=60, deadline=None)
@given(sizes=shapes, seed=st.integers(0, 2**32 - 1))
def test_pack_and_unpack_are_inverse(sizes: list[tuple[int, ...]], seed: int) -> None:
    layout = build(sizes)
    noise = np.random.default_rng(seed)
    values = {f"block{i}": noise.standard_normal(shape) for i, shape in enumerate(sizes)}
    vector = layout.pack(values)
    assert vector.size == layout.size == sum(v.size for v in values.values())
    for name, value in layout.unpack(vector).items():
        np.testing.assert_array_equal(value, values[name])
    again = noise.standard_normal(layout.size)
    np.testing.assert_array_equal(layout.pack(layout.unpack(again)), again)


@settings(max_examples=30, deadline=None)
@given(sizes=shapes)
def test_every_position_belongs_to_one_place(sizes: list[tuple[int, ...]]) -> None:
    layout = build(sizes)
    for position in range(layout.size):
        block, index = layout.locate(position)
        assert block.index[index] == position
    with pytest.raises(IndexError):
        layout.locate(layout.size)


def test_what_is_not_named_is_zero_and_what_is_small_is_spread() -> None:
    layout = build([(2, 3), (2,)])
    np.testing.assert_array_equal(layout.pack({"block0": np.array([1.0, 2.0, 3.0])}), [1, 2, 3, 1, 2, 3, 0, 0])
