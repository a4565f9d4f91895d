"""``ocp replay RUN``: simulate a stored plan under another law."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

from dynamics.contact import ContactLaw
from ocp.factories import closing_law
from ocp.physics.constraints import describe_violations
from ocp.solution import Replay, Solution
from ocp.store.stored_run import StoredRun
from problems.plugin import problem_of
from reports.cli.commands import ReplayOptions
from reports.cli.request import assignments
from reports.cli.solve_command import NOT_CONVERGED
from reports.console import number, small

ReplayRequest = tuple[StoredRun, Solution, ContactLaw]


def check(options: ReplayOptions) -> ReplayRequest:
    """Read the run's plan, and make the law."""
    found = options.stored(options.run)
    problem = problem_of(found, options.own([found]))[2]
    law = closing_law(options.contact, assignments("-c", options.law_settings), problem.system)
    return found, found.solution(problem), law


def run(options: ReplayOptions, request: ReplayRequest) -> int:
    """Simulate the inputs, or the feedback policy, of a stored run under a contact law."""
    (stored, solution, law), output = request, options.output
    rolled = solution.replay(law)
    output.say(
        f"planned cost {number(rolled.planned_cost, 8)};"
        f" under the {law.name} law {number(rolled.cost, 8)}"
    )
    between = rolled.between
    output.say(
        f"largest state difference {small(rolled.state_gap)};"
        f" penetration {small(rolled.penetration)} m"
        + ("" if between is None else f", between nodes {small(between.amount)} m")
    )
    for line in describe_violations(rolled.broken):
        output.say(line)
    output.document(document(stored, rolled))
    return 0 if math.isfinite(rolled.cost) else NOT_CONVERGED


def document(stored: StoredRun, rolled: Replay) -> dict[str, Any]:
    """Return what ``ocp replay --json`` prints.

    ``cost`` under the law, ``planned_cost``, ``state_gap`` max |x - x_replay|, ``penetration`` [m]
    by true signed distance, ``between`` the deepest penetration between nodes, ``broken`` the
    constraints that the replay violates, ``final_state`` (scenario, state), ``inputs`` "open-loop"
    or "feedback".
    """
    same = ("inputs", "cost", "planned_cost", "state_gap", "penetration")
    return {
        "run": str(stored.path),
        "problem": stored.meta["problem"],
        "contact": rolled.law.name,
        "contact_settings": rolled.law.settings(),
        **{name: getattr(rolled, name) for name in same},
        "between": None if rolled.between is None else asdict(rolled.between),
        "broken": [asdict(one) for one in rolled.broken],
        "final_state": rolled.data["x"].values[:, -1],
        "states": [str(name) for name in rolled.data["state"].values],
    }
