"""``ocp replay RUN``: roll a stored plan out under another law."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from reports.cli.common import Contact, Debug, Json, LawSettings, Out, Output, Quiet


def run(
    run: Annotated[str, typer.Argument(help="A run: its path, or part of its name.")],
    contact: Contact = "exact",
    law_settings: LawSettings = None,
    out: Out = Path("runs"),
    as_json: Json = False,
    quiet: Quiet = False,
    debug: Debug = False,
) -> int:
    """Roll the inputs, or the feedback policy, of a stored run out under a contact law."""
    from ocp import store
    from reports.cli.choices import contact_law
    from reports.cli.runs_command import find
    from reports.console import number, small

    law = contact_law(contact, law_settings)
    found = replay(store.load(find(run, out)), law)
    output = Output(as_json, quiet)
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


def replay(stored: Any, law: Any) -> dict[str, Any]:
    """Return what ``ocp replay --json`` prints.

    ``cost`` under the law, ``planned_cost``, ``state_gap`` max |x - x_replay|, ``penetration`` [m]
    by true signed distance, ``final_state`` (scenario, state), ``inputs`` "open-loop" or
    "feedback".
    """
    import numpy as np

    from ocp.judges.audit import signed_distances
    from reports.view import problem_of

    _, _, problem = problem_of(stored)
    solution = stored.solution(problem)
    rolled = solution.replay(law)
    distance = signed_distances(problem, rolled.x, problem.parameters.values)
    deepest = -(rolled.gap if distance is None else distance)
    return {
        "run": str(stored.path),
        "problem": stored.meta["problem"],
        "contact": law.name,
        "contact_settings": law.settings(),
        "inputs": "open-loop" if solution.gains is None else "feedback",
        "cost": rolled.cost,
        "planned_cost": solution.cost,
        "state_gap": float(np.max(np.abs(rolled.x - solution.data["x"].values))),
        "penetration": max(0.0, float(np.max(deepest, initial=0.0))),
        "final_state": rolled.x[:, -1],
        "states": [signal.name for signal in problem.system.states],
    }
