"""All numbers are read by the same grammar."""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import Field

from dynamics.settings import LARGEST, parse_float, parse_int, parse_number

NO_NUMBERS = (
    "",
    "-",
    ".",
    "e5",
    "1e",
    "1_0",
    "１２",
    "٣",
    "0x10",
    "1,5",
    "1d3",
    "--1",
    "1 0",
    "nan",
    "inf",
    "-inf",
    "Infinity",
    "1e999",
    "-1e999",
    "1e-999",
    "true",
)


@pytest.mark.parametrize(
    ("word", "value"),
    [
        ("20", 20),
        ("2e1", 20),
        ("20.0", 20),
        ("20.", 20),
        ("+10", 10),
        (" 10 ", 10),
        ("-3", -3),
        ("2.5E1", 25),
        ("0e0", 0),
        ("9223372036854775807", LARGEST),
        ("1e400", None),
        ("0.5", None),
    ],
)
def test_whole_numbers_however_written(word: str, value: int | None) -> None:
    assert parse_int(word) == (None if value is None else value)
    assert type(parse_int(word)) is (int if value is not None else type(None))


@pytest.mark.parametrize("word", NO_NUMBERS)
def test_nothing_else_is_a_number(word: str) -> None:
    assert parse_float(word) is None and parse_int(word) is None
    for kind in (int, float, int | None, Annotated[float | None, Field(gt=0)]):
        with pytest.raises(ValueError, match="number"):
            parse_number(word, kind)


@pytest.mark.parametrize("word", ["9223372036854775808", "-" + "9" * 5000, "1e23", "1e308"])
def test_whole_numbers_that_are_too_large(word: str) -> None:
    assert parse_int(word) is None
    with pytest.raises(ValueError, match=r"at most 9.2e\+18"):
        parse_number(word, int)


@pytest.mark.parametrize("word", ["0.99999999999999999999", "9007199254740993.5"])
def test_a_number_that_only_a_double_takes_for_whole_is_none(word: str) -> None:
    assert parse_int(word) is None


def test_whole_numbers_beyond_doubles_are_exact() -> None:
    assert parse_int("9007199254740993.0") == 9007199254740993 == parse_int("9.007199254740993e15")


def test_minus_zero_is_zero() -> None:
    assert math.copysign(1.0, parse_float("-0") or 0.0) == 1.0 == math.copysign(1.0, parse_float("-0.0") or 0)
    assert parse_int("-0") == 0


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_every_double_reads_as_itself(value: float) -> None:
    assert parse_float(repr(value)) == value
    assert parse_number(f" {value!r}", float | None) == value


@given(st.integers(-LARGEST, LARGEST))
def test_every_whole_number_reads_as_itself(value: int) -> None:
    assert parse_int(str(value)) == value == parse_number(value, int)


def test_values_are_numbers_as_words_are() -> None:
    assert parse_number(np.float64(2.5), float) == 2.5 and type(parse_number(np.int64(3), int)) is int
    for value, kind in (
        (True, int),
        (True, float),
        (math.nan, float),
        (math.inf, int | None),
        (10**400, float),
        (2**63, int),
        (np.float64("inf"), float),
    ):
        with pytest.raises(ValueError, match="number"):
            parse_number(value, kind)
    assert parse_number(True, bool) is True and parse_number("1_0", str) == "1_0" and parse_number(None, int) is None
