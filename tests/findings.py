"""Access to the findings of a verdict by their codes."""

from __future__ import annotations

from typing import Any

from ocp.judge.verdict import Judgement


def codes(plan: Judgement) -> list[str]:
    """Return the codes of a verdict's findings, in their order."""
    return [finding.code for finding in plan.findings]


def numbers(plan: Judgement, code: str) -> dict[str, Any]:
    """Return the numbers of the first finding with the given ``code``."""
    return next(finding.numbers for finding in plan.findings if finding.code == code)
