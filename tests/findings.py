"""Findings of a verdict by code."""

from __future__ import annotations

from typing import Any

from ocp.judge.verdict import Judgement


def codes(plan: Judgement) -> list[str]:
    """Codes of a verdict's findings, in order."""
    return [finding.code for finding in plan.findings]


def numbers(plan: Judgement, code: str) -> dict[str, Any]:
    """Numbers of the first finding with a code."""
    return next(finding.numbers for finding in plan.findings if finding.code == code)
