"""``ocp laws [LAW]``: contact laws and their settings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from reports.cli.named.settings_command import tell
from reports.cli.options import Command, Options, argument

if TYPE_CHECKING:
    from reports.settings import Group


@dataclass(frozen=True, kw_only=True)
class LawsOptions(Options):
    """One law, or all."""

    law: str | None = argument(default=None, help="One of them; all if not said.")


def check(options: LawsOptions) -> list[Group]:
    """Find the laws."""
    from ocp.errors import choose
    from reports import settings

    found = {group.name: group for group in settings.laws()}
    return [*found.values()] if options.law is None else [choose("law", options.law, found)]


def run(options: LawsOptions, found: list[Group]) -> int:
    """List the contact laws with every setting that -c takes: default, value, meaning."""
    tell(options.output, "laws", found)
    return 0


COMMAND = Command(LawsOptions, check, run, examples=("laws", "laws adaptive", "laws --json"))
