"""Tables of verdicts, methods and step sizes have every named problem, and report solves that did not end."""

from __future__ import annotations

from pathlib import Path

import pytest

from docs.generator import measured
from docs.generator.verdicts import ANALYTIC, LEARNED, METHODS, Measurement, store
from problems import names


def test_every_named_problem_is_in_the_tables_of_solves() -> None:
    laws = [(name, law) for name in names() for law in (*ANALYTIC, *LEARNED)]
    methods = [(f"`{name}`", method) for name in names() for method in METHODS]
    refined = [row[0] for row in measured.read("refined")["rows"]]
    assert [tuple(row[:2]) for row in measured.read("verdicts")["rows"]] == laws
    assert [tuple(row[:2]) for row in measured.read("matrix")["rows"]] == methods
    assert [*dict.fromkeys(refined)] == [*names()]


def test_rows_replace_those_of_the_same_problem(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(measured, "DATA", tmp_path)
    columns = ("problem", "h [s]", "N", "planned", "replayed at h/2", "found")
    wall = [["wall-1d", "0.1", 20, "1", "1", ""], ["wall-1d", "0.05", 40, "1", "1", "agree"]]
    old = [["push-disc", "0.1", 20, "1", "1", ""], *wall]
    new = [["push-disc", "0.2", 10, "2", "2", ""], ["push-disc", "0.1", 20, "2", "2", "agree"]]
    measured.write_table("refined", title="t", command="make x", columns=columns, rows=old)
    store("refined", new, keys=1)
    assert measured.read("refined")["rows"] == [*wall, *new]


def test_a_command_over_its_limit_says_so_and_a_refusal_is_told(tmp_path: Path) -> None:
    assert Measurement("hopper", tmp_path, limit_s=1).solve("direct", "exact") == "over 1 s"
    refused = Measurement("wall-1d", tmp_path, limit_s=60).solve("direct", "barrier", "-c", "mu=-1")
    assert str(refused).startswith("barrier: mu must be ")
