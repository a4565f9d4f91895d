"""``ocp methods``: how a problem becomes a program, and the policies that it may decide."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from reports.cli.list_command import named
from reports.cli.options import Command, Options

if TYPE_CHECKING:
    from reports.settings import Group

    Found = tuple[list[dict[str, Any]], list[Group]]


def check(options: Options) -> Found:
    """Find the methods, and the settings that any of them takes."""
    from reports import settings

    return [dict(row) for row in settings.methods()], [settings.solves(), *settings.policies()]


def run(options: Options, found: Found) -> int:
    """List the methods and policies of ocp solve, with every setting that -s takes of them."""
    from reports.cli.named.settings_command import told

    methods, groups = found
    output = options.output
    output.document({"methods": methods, "settings": [group.row() for group in groups]})
    if not options.as_json:
        for method in methods:
            print(named(method["name"], method["summary"]))
        print()
        told(groups)
    return 0


COMMAND = Command(Options, check, run, examples=("methods", "methods --json"))
