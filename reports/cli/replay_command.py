"""``ocp replay RUN``: roll a stored plan out under another law."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from reports.cli.options import Command, LawOptions, RunOptions, SourceOptions, option
from reports.cli.solve_command import NOT_CONVERGED

if TYPE_CHECKING:
    from dynamics.contact import ContactLaw
    from ocp.replay import Replay
    from ocp.solution import Solution
    from ocp.store.stored_run import StoredRun

    Asked = tuple[StoredRun, Solution, ContactLaw]


@dataclass(frozen=True, kw_only=True)
class ReplayOptions(RunOptions, LawOptions, SourceOptions):
    """Which run, under which law."""

    contact: str = option("exact", "--contact", help="Contact law; ocp list shows them.")


def check(options: ReplayOptions) -> Asked:
    """Read the run's plan, and make the law."""
    from problems.plugin import problem_of
    from reports.cli.request import closing_law
    from reports.cli.runs_command import stored

    found = stored(options.run, options.out)
    problem = problem_of(found, options.own([found]))[2]
    law = closing_law(options.contact, options.law_settings, problem.system)
    return found, found.solution(problem), law


def run(options: ReplayOptions, asked: Asked) -> int:
    """Roll the inputs, or the feedback policy, of a stored run out under a contact law."""
    from ocp.physics.constraints import describe_violations
    from reports.console import number, small

    (stored, solution, law), output = asked, options.output
    rolled = solution.replay(law)
    output.say(
        f"planned cost {number(rolled.planned_cost, 8)};"
        f" under the {law.name} law {number(rolled.cost, 8)}"
    )
    way = rolled.between
    output.say(
        f"the states part by at most {small(rolled.state_gap)};"
        f" penetration {small(rolled.penetration)} m"
        + ("" if way is None else f", between nodes {small(way.amount)} m")
    )
    for words in describe_violations(rolled.broken):
        output.say(words)
    output.document(document(stored, rolled))
    return 0 if math.isfinite(rolled.cost) else NOT_CONVERGED


def document(stored: StoredRun, rolled: Replay) -> dict[str, Any]:
    """Return what ``ocp replay --json`` prints.

    ``cost`` under the law, ``planned_cost``, ``state_gap`` max |x - x_replay|, ``penetration`` [m]
    by true signed distance, ``between`` the deepest on the way between nodes, ``broken`` the
    constraints that the replay breaks, ``final_state`` (scenario, state), ``inputs`` "open-loop" or
    "feedback".
    """
    return {
        "run": str(stored.path),
        "problem": stored.meta["problem"],
        "contact": rolled.law.name,
        "contact_settings": rolled.law.settings(),
        "inputs": rolled.inputs,
        "cost": rolled.cost,
        "planned_cost": rolled.planned_cost,
        "state_gap": rolled.state_gap,
        "penetration": rolled.penetration,
        "between": None if rolled.between is None else asdict(rolled.between),
        "broken": [asdict(one) for one in rolled.broken],
        "final_state": rolled.data["x"].values[:, -1],
        "states": [str(name) for name in rolled.data["state"].values],
    }


COMMAND = Command(
    ReplayOptions,
    check,
    run,
    examples=(
        "replay @last",
        "replay @last --contact barrier -c mu=1e-2",
    ),
)
