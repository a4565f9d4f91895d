"""Counts of the benchmark of complementarity problems."""

from __future__ import annotations

import os
import time
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from ocp.mpcc import MPCC, solve
from tests.benchmarks.mpcc.bench import at_reference, disproof, limited, references, residuals
from tests.benchmarks.mpcc.report import Row, summary
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
    assert known == {"a": (0.01399, pytest.approx(5e-6)), "b": (17.0, pytest.approx(5e-5))}
    assert at_reference(0.0139949, known["a"], 1.0)
    assert not at_reference(0.0139990, known["a"], 1.0)
    assert at_reference(-5.0, known["b"], 1.0)
    assert not at_reference(-5.0, known["b"], -1.0)
    assert at_reference(16.9999, known["b"], -1.0)
    assert not at_reference(1.0, (float("nan"), 0.0), 1.0)


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
        ({"hit": False}, ["at the reference"]),
        ({"stationarity": "not"}, ["certified"]),
        ({"seconds": 3.0}, ["time"]),
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
        time.sleep(60)
        return {}

    def raise_() -> dict[str, object]:
        raise ValueError("no good")

    def die() -> dict[str, object]:
        os._exit(3)

    assert limited(0.2, "s", hang)["s"] == 0.2
    assert "no answer in 0.2 s" in limited(0.2, "s", hang)["note"]
    assert "no good" in limited(10.0, "s", raise_)["note"]
    assert "ended without an answer" in limited(10.0, "s", die)["note"]
    assert limited(10.0, "s", lambda: {"cost": 1.0}) == {"cost": 1.0}


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
