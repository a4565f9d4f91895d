"""``ocp settings [WORD]``: every -s and -c setting with type, default and meaning."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from textwrap import fill
from typing import TYPE_CHECKING

from reports.cli.options import Command, Options, argument

if TYPE_CHECKING:
    from reports.cli.output import Output
    from reports.settings import Group


@dataclass(frozen=True, kw_only=True)
class SettingsOptions(Options):
    """Of what, or which."""

    word: str | None = argument(
        default=None, help="A law, policy, solver, estimator or algorithm, or a setting's name."
    )


def check(options: SettingsOptions) -> list[Group]:
    """Find what is asked for; without a word all but the solvers' many options."""
    from reports import settings

    if options.word is not None:
        return settings.matching(options.word)
    return [*settings.groups(), settings.changed(settings.solver("ipopt"))]


def run(options: SettingsOptions, found: list[Group]) -> int:
    """List every setting that -s and -c take: default, value, meaning.

    Of the solver those that are set here otherwise than it would; ocp settings ipopt has them all.
    """
    tell(options.output, "settings", found)
    return 0


def tell(output: Output, key: str, groups: Sequence[Group]) -> None:
    """Print the groups, as one JSON document under ``key`` where that was asked for."""
    output.document({key: [group.row() for group in groups]})
    if not output.as_json:
        told(groups)


def told(groups: Sequence[Group]) -> None:
    """Print each group: a heading of its own, then its settings, or that it has none."""
    from reports.settings import line

    for number, group in enumerate(groups):
        if number:
            print()
        head = f"{group.name} ({group.said})" if group.settings else group.name
        print(fill(f"{head}: {group.summary}{'' if group.settings else '; no settings'}", 80))
        for setting in group.settings:
            print(line(setting))


COMMAND = Command(
    SettingsOptions, check, run,
    examples=("settings", "settings ipopt", "settings fopg", "settings tol"),
)  # fmt: skip
