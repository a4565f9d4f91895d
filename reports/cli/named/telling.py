"""Print groups of settings."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import fill
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from reports.cli.output import Output
    from reports.known.settings import Group


def tell(output: Output, key: str, groups: Sequence[Group]) -> None:
    """Print the groups, as one JSON document under ``key`` where that was asked for."""
    output.document({key: [group.row() for group in groups]})
    if not output.as_json:
        told(groups)


def told(groups: Sequence[Group]) -> None:
    """Print each group: a heading of its own, then its settings, or that it has none."""
    from reports.known.settings import line

    for number, group in enumerate(groups):
        if number:
            print()
        head = f"{group.name} ({group.said})" if group.settings else group.name
        print(fill(f"{head}: {group.summary}{'' if group.settings else '; no settings'}", 80))
        for setting in group.settings:
            print(line(setting))
