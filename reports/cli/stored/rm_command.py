"""``ocp runs rm RUN...``: delete runs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from reports.cli.options import Command, StoreOptions, argument


@dataclass(frozen=True, kw_only=True)
class RmOptions(StoreOptions):
    """Which runs."""

    runs: list[str] = argument(metavar="RUN...", help="Runs, as ocp runs names them.")


def check(options: RmOptions) -> list[Path]:
    """Find the runs, and see that each is one."""
    from ocp.store.lookup import check_removable, find

    found = [find(text, options.out) for text in options.runs]
    for path in found:
        check_removable(path)
    return found


def run(options: RmOptions, found: list[Path]) -> int:
    """Delete stored runs, damaged ones too; nothing is deleted unless all of them are runs."""
    from ocp.store.lookup import remove

    remove(found)
    for path in found:
        options.output.say(f"removed: {path}")
    options.output.document({"removed": [str(path) for path in found]})
    return 0


COMMAND = Command(RmOptions, check, run, examples=("runs rm @last", "runs rm @2 @3 @4"))
