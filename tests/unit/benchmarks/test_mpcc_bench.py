"""Counts of the benchmark of complementarity problems."""

from __future__ import annotations

import json
import math
import os
import time
from dataclasses import asdict, replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from ocp.mpcc import MPCC, solve
from tests.benchmarks.mpcc.bench import at_reference, disproof, limited, references, residuals, stored_rows
from tests.benchmarks.mpcc.report import Row, counts, summary
from tests.benchmarks.mpcc.scholtes_peer import solve as loop

pytestmark = pytest.mark.bench


def a_row(**fields: object) -> Row:
    good = {
        "name": "a",
        "reference": 1.0,
        "cost": 1.0,
        "stationarity": "B",
        "audited": True,
        "hit": True,
        "seconds": 1.0,
        "peer_seconds": 2.0,
    }
    return Row(**{**good, **fields})


def test_a_reference_is_reached_within_its_digits(tmp_path: Path) -> None:
    table = "name,solution\na,1.399E-02\nb,17.0000\nc,(I)\nd,tba\n"
    (tmp_path / "reference.csv").write_text(table)
    known = references(tmp_path)
    assert known == {"a": (0.01399, pytest.approx(5e-6)), "b": (17.0, pytest.approx(5e-5)), "c": (math.inf, 0.0)}
    assert at_reference(0.0139949, known["a"], 1.0)
    assert not at_reference(0.0139990, known["a"], 1.0)
    assert at_reference(-5.0, known["b"], 1.0)
    assert not at_reference(-5.0, known["b"], -1.0)
    assert at_reference(16.9999, known["b"], -1.0)
    assert not at_reference(1.0, (float("nan"), 0.0), 1.0)


def test_the_loop_is_compared_on_what_it_finishes() -> None:
    rows = [a_row(seconds=3.0, peer_seconds=2.0), a_row(seconds=10.0, peer_seconds=120.0, peer_note="not finished")]
    lines = {what: (here, loop) for what, here, loop in counts(rows)}
    assert lines["processor seconds in all"] == ("13", "122")
    assert lines["of the 1 that the loop finishes"] == ("3", "2")
    assert lines["audited, of 2"] == ("2", "0")


def test_rows_of_another_commit_are_measured_again(tmp_path: Path) -> None:
    row = a_row(peer_cost=1.0)
    file, identity = tmp_path / "rows.json", {"commit": "a", "limit": 1, "check": False}
    assert stored_rows(file, identity) == {}
    file.write_text(json.dumps({"identity": identity, "rows": {"a": asdict(row)}}))
    assert stored_rows(file, identity) == {"a": row}
    assert stored_rows(file, {**identity, "commit": "b"}) == {}


def test_residuals_see_bounds_rows_signs_and_pairs() -> None:
    x = ca.SX.sym("x", 2)
    mpcc = MPCC(x, x[0], x[0], x[1], g=x[0] + x[1], ubx=3.0, lbg=0.0, ubg=4.0)
    assert residuals(mpcc, np.array([0.0, 2.0])) == (0.0, 0.0, 0.0)
    assert residuals(mpcc, np.array([0.0, 3.5]))[0] == pytest.approx(0.5)
    assert residuals(mpcc, np.array([-0.25, 1.0]))[0] == pytest.approx(0.25)
    assert residuals(mpcc, np.array([3.0, 2.0])) == pytest.approx((1.0, 2.0, 6.0))


@pytest.mark.parametrize(
    ("fields", "missed"),
    [
        ({}, []),
        ({"audited": False, "hit": False}, ["audited"]),
        ({"audited": False, "hit": False, "reference": math.inf, "infeasible": True}, []),
        ({"hit": False}, ["at the reference"]),
        ({"stationarity": "not"}, ["certified"]),
        ({"seconds": 4.5}, ["time"]),
        ({"seconds": 4.5, "peer_note": "not finished"}, []),
        ({"disproved": "start 1"}, ["certificates that hold"]),
    ],
)
def test_a_missed_floor_is_named(fields: dict[str, object], missed: list[str]) -> None:
    text, found = summary([a_row(**fields)], checked=True)
    assert found == missed
    assert ("- a: " in text) == bool(set(missed) - {"time"})


def test_no_problem_stops_the_run() -> None:
    """Problems that hang, raise an error, or kill the process do not stop the run."""

    def hang() -> dict[str, object]:
        while True:
            math.sqrt(2.0)

    def wait() -> dict[str, object]:
        time.sleep(1.5)
        return {"cost": 2.0}

    def raise_() -> dict[str, object]:
        raise ValueError("no good")

    def die() -> dict[str, object]:
        os._exit(3)

    assert limited(1, "s", hang) == {"s": 1.0, "note": "not finished in 1 s of processor time"}
    assert "no good" in limited(10, "s", raise_)["note"]
    assert "ended without an answer" in limited(10, "s", die)["note"]
    assert limited(10, "s", lambda: {"cost": 1.0}) == {"cost": 1.0}
    assert limited(1, "s", wait) == {"cost": 2.0}, "time in which a process does not run does not count"


def test_the_peer_is_a_scholtes_loop() -> None:
    """The peer solves ``min (x - 1)² + (y - 2)²`` over a pair, from near the better minimum (0, 2)."""
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    mpcc = MPCC(ca.vertcat(x, y), (x - 1) ** 2 + (y - 2) ** 2, x, 2 * y)
    found = loop(mpcc, np.array([0.1, 2.0]))
    assert found.converged
    assert found.x == pytest.approx([0, 2], abs=1e-4)
    assert found.f == pytest.approx(1.0, abs=1e-6)


def test_a_certificate_that_does_not_hold_is_disproved() -> None:
    """``(x - 1)² + y²`` has its minimum at (1, 0), so that a certificate 0.005 away is wrong."""
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    mpcc = MPCC(ca.vertcat(x, y), 100 * (x - 1) ** 2 + y**2, x, y)
    right = solve(mpcc, [2.0, 0.0])
    assert disproof(mpcc, np.array([2.0, 0.0]), right) == ""
    off = np.array([1.005, 0.0])
    wrong = replace(right, x=off, f=100 * 0.005**2)
    assert "falls by 0.0025" in disproof(mpcc, np.array([2.0, 0.0]), wrong)
