"""``ocp replay RUN``: roll a stored plan out under another law."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from reports.cli.declared import argument, option
from reports.cli.options import RUN, Command, LawOptions, SourceOptions

if TYPE_CHECKING:
    from dynamics.contact import ContactLaw
    from ocp.problem import Problem
    from ocp.solution import Solution
    from ocp.store.stored_run import StoredRun

    Asked = tuple[StoredRun, Solution, Problem, ContactLaw]


@dataclass(frozen=True, kw_only=True)
class ReplayOptions(LawOptions, SourceOptions):
    """Which run."""

    run: str = argument(help=RUN)
    contact: str = option("exact", "--contact", help="Contact law; ocp list shows them.")


def check(options: ReplayOptions) -> Asked:
    """Read the run's plan, and make the law."""
    from problems.lent import problem_of
    from reports.cli.choices import closing_law
    from reports.cli.runs_command import stored

    found = stored(options.run, options.out)
    problem = problem_of(found, options.own([found]))[2]
    law = closing_law(options.contact, options.law_settings, problem.system)
    return found, found.solution(problem), problem, law


def run(options: ReplayOptions, asked: Asked) -> int:
    """Roll the inputs, or the feedback policy, of a stored run out under a contact law."""
    from reports.console import number, small

    found = replay(*asked)
    law, output = asked[-1], options.output
    output.say(
        f"planned cost {number(found['planned_cost'], 8)};"
        f" under the {law.name} law {number(found['cost'], 8)}"
    )
    output.say(
        f"the states part by at most {small(found['state_gap'])};"
        f" penetration {small(found['penetration'])} m"
    )
    output.document(found)
    return 0


def replay(
    stored: StoredRun, solution: Solution, problem: Problem, law: ContactLaw
) -> dict[str, Any]:
    """Return what ``ocp replay --json`` prints.

    ``cost`` under the law, ``planned_cost``, ``state_gap`` max |x - x_replay|, ``penetration`` [m]
    by true signed distance, ``final_state`` (scenario, state), ``inputs`` "open-loop" or
    "feedback".
    """
    rolled = solution.replay(law)
    return {
        "run": str(stored.path),
        "problem": stored.meta["problem"],
        "contact": law.name,
        "contact_settings": law.settings(),
        "inputs": rolled.inputs,
        "cost": rolled.cost,
        "planned_cost": rolled.planned_cost,
        "state_gap": rolled.state_gap,
        "penetration": rolled.penetration,
        "final_state": rolled.data["x"].values[:, -1],
        "states": [signal.name for signal in problem.system.states],
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
