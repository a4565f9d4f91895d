"""Comparisons name runs by their differences, and set units and symbols in readable form."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from ocp.labelled import LabelledArrays
from ocp.store.stored_run import StoredRun
from reports.documents.common import as_text
from reports.documents.comparison import run_labels
from reports.drawing.notation import in_symbols, label, powers, symbol


def run(place: int, **asked: Any) -> StoredRun:
    record = {
        "problem": "push-disc",
        "contact": "barrier",
        "contact_settings": {"mu": 1e-3},
        "method": "direct",
        "policy": "open-loop",
        "params": {"M": 1.0, "h": 0.1},
        "audit_s": 0.1 * place,
        "law_parameters": {"contact.mu": place},
        **asked,
    }
    return StoredRun(Path(f"runs/{place}"), LabelledArrays({}), {"record": record, "hash": f"h{place}abcde"})


def named(*asked: dict[str, Any]) -> list[str]:
    return run_labels([run(place, **each) for place, each in enumerate(asked)])


def test_only_what_differs_is_told() -> None:
    assert named({}, {"params": {"M": 2.0, "h": 0.1}}) == ["M = 1", "M = 2"]
    assert named({}, {"policy": "feedback"}) == ["open-loop", "feedback"]
    assert named({}, {"contact_settings": {"mu": 1e-2}}) == ["μ = 0.001", "μ = 0.01"]


def test_a_setting_of_one_law_does_not_tell_it_from_another_law() -> None:
    exact = {"contact": "exact", "contact_settings": {}, "strategy": "central-path"}
    assert named({}, exact) == ["barrier", "exact"]
    both = named({}, {"contact_settings": {"mu": 1e-2}}, exact)
    assert both == ["barrier, μ = 0.001", "barrier, μ = 0.01", "exact"]


def test_runs_of_different_problems_are_told_by_problem_and_law() -> None:
    cart = {"problem": "cart-walls", "params": {"k": 100.0, "h": 0.04}}
    assert named({}, cart) == ["push-disc, barrier", "cart-walls, barrier"]
    heavy = {"params": {"M": 2.0, "h": 0.1}}
    assert named({}, heavy, cart) == ["push-disc, barrier, M = 1", "push-disc, barrier, M = 2", "cart-walls, barrier"]
    assert named(cart, cart, {})[0] == "cart-walls, barrier, h0abcd"


def test_equal_runs_are_told_by_their_hashes() -> None:
    assert named({}, {}) == ["h0abcd", "h1abcd"]


@pytest.mark.parametrize(
    ("unit", "written"),
    [
        ("m/s^2", "m/s²"),
        ("1/m^2", "m⁻²"),
        ("1/rad", "rad⁻¹"),
        ("kg m^2", "kg m²"),
        ("1", ""),
        ("1/(N s)^2", "1/(N s)²"),
        ("s^2/m^2", "s²/m²"),
        ("m^-3", "m⁻³"),
    ],
)
def test_units_have_raised_powers(unit: str, written: str) -> None:
    assert powers(unit) == written
    assert label("w", unit) == (f"w [{written}]" if written else "w")


def test_symbols_of_laws_and_parameters() -> None:
    assert (symbol("contact.mu"), symbol("nu"), symbol("goal_x")) == ("μ", "ν", "goal_x")
    assert in_symbols("0 <= lam ⟂ gap >= 0, lam gap = mu") == "0 ≤ λ ⟂ gap ≥ 0, λ gap = μ"
    assert in_symbols("multiplies lamps") == "multiplies lamps"


def test_values_in_a_line_are_no_python() -> None:
    assert as_text(["zobg", "fobg"]) == "zobg, fobg"
    assert (as_text(True), as_text(1e-3), as_text("ipopt")) == ("yes", "0.001", "ipopt")
