"""Pages of laws, methods and settings, from their declarations, as ``ocp settings`` has them."""

from __future__ import annotations

from collections.abc import Sequence

from reports import settings
from reports.settings import Group
from reports.site.markdown import escaped, table

SAID = {
    "laws": "Contact laws, `--contact LAW`, and what `-c NAME=VALUE` says to each. `ocp laws`"
    " prints the same, `ocp laws adaptive` one of them.",
    "solves": "Methods and policies of `ocp solve`, and what `-s NAME=VALUE` says to them."
    " `ocp methods` prints the same.",
    "estimators": "Estimators that mix two orders, and what `ocp estimate -s` says to them.",
    "training": "What `ocp train -s` says to all algorithms, and to each.",
    "solver": "Options of IPOPT that are set here otherwise than it would, each to be said by"
    " `-s NAME=VALUE`, as any other of its options. `ocp settings ipopt` lists them all, with"
    " IPOPT's own words.",
}


def pages() -> dict[str, str]:
    """Laws, methods, estimators, training and the solver, a page each, and a list of them."""
    methods = [(f"`{row['name']}`", escaped(row["summary"])) for row in settings.methods()]
    solves = [settings.solves(), *settings.policies()]
    shown = {
        "laws": page("Contact laws", SAID["laws"], settings.laws()),
        "solves": page(
            "Methods and policies",
            f"{SAID['solves']}\n\n{table(('`--method`', ''), methods)}",
            solves,
        ),
        "estimators": page("Estimators", SAID["estimators"], settings.estimators()),
        "training": page("Training", SAID["training"], settings.training()),
        "solver": page("IPOPT", SAID["solver"], [settings.changed(settings.solver("ipopt"))]),
    }
    return {
        "settings/index.md": index(),
        **{f"settings/{name}.md": text for name, text in shown.items()},
    }


def index() -> str:
    """List the pages."""
    rows = "".join(f"- [{name.capitalize()}]({name}.md): {said}\n" for name, said in SAID.items())
    return (
        "# Settings\n\nEvery setting, from where it is declared. An unknown one is refused with"
        f" the nearest name.\n\n{rows}"
    )


def page(title: str, said: str, groups: Sequence[Group]) -> str:
    """One page: what is set and how, then a table a group."""
    return "\n".join([f"# {title}\n", f"{said}\n", *map(section, groups)])


def section(group: Group) -> str:
    """One group: what it is, how a setting of it is said, and its settings."""
    head = f"## {group.name}\n\n{escaped(group.summary)}.\n"
    if not group.settings:
        return f"{head}\nIt has no settings.\n"
    rows = [
        (f"`{one.name}`", code(settings.shown(one.default)), one.kind, escaped(one.meaning))
        for one in group.settings
    ]
    columns = (f"`{group.said}`", "default", "value", "meaning")
    return f"{head}\n{table(columns, rows)}"


def code(text: str) -> str:
    """Write a default as it would be said; nothing for none."""
    return f"`{text}`" if text else ""
