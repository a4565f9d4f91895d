"""Continuation in mu needs fewer iterations than the same sweep with cold starts."""

from __future__ import annotations

import pytest

from dynamics.contact import Barrier
from ocp.continuation import continue_over
from tests.benchmarks.ocp.cases import FIVE, session
from tests.benchmarks.ocp.race import tell


@pytest.mark.bench
def test_continuation_needs_a_sixth_of_the_cold_iterations() -> None:
    """mu goes from 1 to 1e-8 in 20 steps; cold solves start every point at the problem's own guess."""
    rows, ratios, builds = [], {}, []
    for name in FIVE:
        path = continue_over(session(name, Barrier(mu=1.0)), "contact.mu", 1.0, 1e-8, 20, "log")
        assert path.break_reason is None
        cold, iterations, better, failed = session(name, Barrier(mu=1.0), homotopy=False), 0, 0, 0
        for point in path.points:
            cold.values["contact.mu"] = point.value
            outcome = cold.solve()
            iterations += outcome.trace.iterations
            failed += not outcome.result.ok
            better += outcome.result.ok and outcome.result.f < point.solution.cost * (1 - 1e-4)
        ratios[name] = iterations / path.iterations
        builds.append(path.nlp_builds)
        rows.append(
            [
                name,
                len(path.points),
                path.iterations,
                iterations,
                f"{ratios[name]:.1f}",
                path.nlp_builds,
                better,
                failed,
            ]
        )
    columns = ["problem", "points", "iterations", "cold", "ratio", "NLPs built", "cold is better", "cold fails"]
    tell("Continuation over mu", columns, rows)
    assert ratios["push-disc"] >= 6
    assert builds == [1] * len(FIVE)
