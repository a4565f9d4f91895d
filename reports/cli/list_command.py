"""``ocp list``: everything that has a name."""

from __future__ import annotations

from textwrap import fill
from typing import Any

from reports.cli.options import Command, Options

_MARGIN = 21
Catalogue = dict[str, list[dict[str, Any]]]


def run(options: Options, content: Catalogue) -> int:
    """List named problems, tasks, algorithms, contact laws, methods, policies, solvers, figures."""
    options.output.document(content)
    if not options.as_json:
        for title, items in content.items():
            if items:
                print(title)
            for item in items:
                print(named(item["name"], item["summary"]))
    return 0


def named(name: str, summary: str) -> str:
    """A name and what it is, on lines of 80 columns."""
    head = f"  {name:<{_MARGIN - 3}} "
    return fill(head + summary, 80, subsequent_indent=" " * _MARGIN, break_on_hyphens=False)


def catalogue(options: Options) -> Catalogue:
    """Return what ``ocp list --json`` prints: per kind, objects with name and summary."""
    from dynamics.laws import LAWS
    from ocp.gradients.estimators import SAMPLED
    from ocp.gradients.interpolation import RULES
    from ocp.learning.algorithms import ALGORITHMS
    from ocp.policy import POLICIES
    from ocp.programs.solver import SOLVERS
    from ocp.transcription import METHODS
    from problems import names, spec, studies
    from problems.objectives import objective_names, objective_spec
    from problems.tasks import registry as tasks

    def classes(known: Any) -> list[dict[str, Any]]:
        return [{"name": name, "summary": known[name].summary} for name in known]

    return {
        "problems": [{"name": name, "summary": spec(name).title} for name in names()],
        "tasks": [{"name": name, "summary": tasks.spec(name).title} for name in tasks.names()],
        "algorithms": classes(ALGORITHMS),
        "contacts": classes(LAWS),
        "methods": classes(METHODS),
        "policies": classes(POLICIES),
        "solvers": [{"name": name, "summary": SOLVERS[name]} for name in SOLVERS],
        "objectives": [
            {"name": name, "summary": objective_spec(name).title} for name in objective_names()
        ],
        "estimators": classes({**SAMPLED, **RULES}),
        "figures": [{"name": i, "summary": studies.get(i).title} for i in studies.ids()],
    }


COMMAND = Command(Options, catalogue, run, examples=("list", "list --json"))
