"""Measured numbers of the site are found with their commands, and no others are."""

import math
import shlex

import pytest

from reports.cli.app import main
from tests.benchmarks import numbers
from tests.benchmarks.numbers import Measured, marked

PAGE = "It costs 0.15425<!-- measured: ocp solve wall-1d | cost --> and takes 1,184 steps"


def test_a_number_in_prose_carries_its_command() -> None:
    assert list(marked(PAGE, "page.md")) == [Measured("page.md", "0.15425", "ocp solve wall-1d", "cost")]


@pytest.mark.parametrize(
    ("text", "path", "same", "other"),
    [
        ("17.94", "cost", (17.9401, 17.9459, 17.9341), (17.947, 17.933)),
        ("1.2e-3", "cost", (0.00121,), (0.00127,)),
        ("1,184", "iterations", (1184, 1165), (1100, 1250)),
    ],
)
def test_a_number_agrees_to_what_is_printed_of_it(
    text: str, path: str, same: tuple[float, ...], other: tuple[float, ...]
) -> None:
    number = Measured("page.md", text, "ocp solve wall-1d", path)
    assert all(number.agrees(found) for found in same)
    assert not any(number.agrees(found) for found in (*other, math.nan))


def test_a_stale_number_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(numbers, "document", lambda _: {"cost": 17.83, "points": [{"cost": 2.0}]})
    right = Measured("page.md", "17.83", "ocp solve wall-1d", "cost")
    stale = Measured("page.md", "3.0", "ocp solve wall-1d", "points.-1.cost")
    assert len(numbers.compare([right, stale])) == 1
    assert not numbers.compare([right])


def test_every_measured_number_has_a_command_that_is_one(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """All commands and options of measured numbers exist in ``ocp``."""
    found = [*numbers.in_prose(), *numbers.in_tables()]
    assert len(found) > 400
    said: dict[str, str] = {}
    for one in found:
        for line in one.command.split(" && "):
            program, command, *words = shlex.split(line)
            assert program == "ocp"
            if command not in said:
                assert main([command, "--help"]) == 0
                said[command] = capsys.readouterr().out
            for word in words:
                assert not word.startswith("--") or word in said[command], one
