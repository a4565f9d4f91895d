"""Lines of a page on the request: only settings that differ, and sources with one full stop."""

from __future__ import annotations

from ocp import solve
from ocp.store.runs import in_memory_run
from problems import get, spec
from reports.documents.common import run_summary


def test_the_page_of_a_plain_solve_shows_no_empty_setting() -> None:
    run = in_memory_run(solve(get("push-disc", N=3), contact="exact"))
    summary = run_summary(run, spec("push-disc"), {})
    assert all(text for _, text in summary["settings"])
    assert "unbounded" not in dict(summary["settings"])
    assert summary["citation"].endswith("?")
