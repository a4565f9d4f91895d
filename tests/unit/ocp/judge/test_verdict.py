"""Findings on the referee, from judgements with made numbers."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ocp.judge.verdict import _referee_cost, _referee_findings


def judgement(**changes: Any) -> Any:
    """Return a judgement of a plan of the cost 2 that survives; ``changes`` are numbers of its referee."""
    referee = {
        "survives": True,
        "survives_at_h": True,
        "word": "survives",
        "note": "true gaps",
        "findings": [],
        "refined_reasons": [],
        "cost": 2.0,
        "refined_cost": 2.0,
        "gap": 0.0,
        "replay_between": None,
    }
    return SimpleNamespace(
        referee=SimpleNamespace(**{**referee, **changes}), cost_share=lambda change, cost: change / abs(cost)
    )


@pytest.mark.parametrize(("refined", "reported"), [(2.0, False), (2.0001, False), (3.0, True), (1.0, True)])
def test_a_cost_that_changes_at_a_quarter_of_the_step_is_reported(refined: float, reported: bool) -> None:
    codes = [finding.code for finding in _referee_findings(judgement(refined_cost=refined))]
    assert codes == ["referee", *["quarter-step-cost"] * reported]


def test_a_plan_without_referee_has_no_other_finding_of_it() -> None:
    assert [finding.code for finding in _referee_findings(judgement(survives=None))] == ["no-referee"]
    words = [
        _referee_cost(judgement(**changes))
        for changes in ({}, {"survives": None}, {"cost": np.nan}, {"cost": np.nan, "gap": np.nan})
    ]
    assert words == ["referee 2", "no referee", "referee cost not finite", "referee not replayed"]
