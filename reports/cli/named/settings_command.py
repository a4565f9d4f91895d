"""``ocp settings [WORD]``: every -s and -c setting with type, default and meaning."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from reports.cli.declared import argument
from reports.cli.named.telling import tell
from reports.cli.options import Command, Options

if TYPE_CHECKING:
    from reports.known.settings import Group


@dataclass(frozen=True, kw_only=True)
class SettingsOptions(Options):
    """Of what, or which."""

    word: str | None = argument(
        default=None, help="A law, policy, solver, estimator or algorithm, or a setting's name."
    )


def check(options: SettingsOptions) -> list[Group]:
    """Find what is asked for; without a word all but the solvers' many options."""
    from reports.known import settings

    if options.word is not None:
        return settings.matching(options.word)
    return [*settings.groups(), settings.changed(settings.solver("ipopt"))]


def run(options: SettingsOptions, found: list[Group]) -> int:
    """List every setting that -s and -c take: default, value, meaning.

    Of the solver those that are set here otherwise than it would; ocp settings ipopt has them all.
    """
    tell(options.output, "settings", found)
    return 0


COMMAND = Command(
    SettingsOptions, check, run,
    examples=("settings", "settings ipopt", "settings fopg", "settings tol"),
)  # fmt: skip
