"""A continuation path across changes of contact, compared with cold solves at every point."""

from __future__ import annotations

import pytest

from dynamics.contact import Exact
from ocp import Direct, solve
from ocp.continuation import continue_over
from ocp.solve.solve import new_session
from problems import get


@pytest.mark.slow
def test_planar_push_is_followed_across_changes_of_contact() -> None:
    """No cold solve from five starts is cheaper, and every change of contact is reported as an event.

    In a pair the multiplier, the gap or both are zero; between two points without a switch this
    changes exactly for the pairs of the reported events. Degenerate events do not name their pairs.
    """
    path = continue_over(new_session(get("planar-push"), Exact(), Direct()), "goal_x", 0.3, 1.5, 12)
    assert path.break_reason is None
    assert sum(event.kind == "contact" for event in path.events) >= 3
    for point in path.points:
        cold = solve(get("planar-push", goal_x=point.value), Exact(), Direct(), n_starts=5)
        assert point.solution.cost <= cold.cost * (1 + 1e-6)
    switches = [e.value for e in path.events if e.kind in ("switch", "degenerate")]
    for before, after in zip(path.points[:-1], path.points[1:], strict=True):
        if any(before.value < value <= after.value for value in switches):
            continue
        told = {
            (event.contact, step)
            for event in path.events
            if event.kind == "contact" and before.value <= event.value <= after.value
            for step in event.steps
        }
        assert changed(before.solution, after.solution) == told


def changed(before, after) -> set[tuple[str, int]]:
    """Return the pairs (contact, step) with impulse in only one of two solutions, or with a gap in only one."""
    found = set()
    for name in ("lam", "gap"):
        was, now = (solution.data[name].isel(scenario=0) > 1e-7 for solution in (before, after))
        differ = was != now
        for step, contact in zip(*differ.values.nonzero(), strict=True):
            found.add((str(differ["contact"].values[contact]), int(step)))
    return found
