"""``ocp runs [RUN]``: what the store holds."""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any

from reports.cli.options import RUN, Command, StoreOptions, argument, option

if TYPE_CHECKING:
    from ocp.store.stored_run import StoredRun

    Asked = tuple[StoredRun | None, datetime | None]

FILTERS = ("problem", "kind", "contact", "method", "algorithm", "status")
"""What a listing may be narrowed to, as its objects name it."""
_SECONDS = {"s": 1, "m": 60, "h": 3600, "d": 86400, "w": 7 * 86400}


@dataclass(frozen=True, kw_only=True)
class RunsOptions(StoreOptions):
    """One run, or those of all that are like this."""

    run: str | None = argument(default=None, help=RUN)
    problem: str | None = option(None, "--problem", help="Those of a problem.")
    kind: str | None = option(None, "--kind", help="Those of solve, continue, estimate, train, ...")
    contact: str | None = option(None, "--contact", help="Those under a contact law.")
    method: str | None = option(None, "--method", help="Those by a method.")
    algorithm: str | None = option(None, "--algorithm", help="Those trained by an algorithm.")
    status: str | None = option(
        None, "--status", help="Those that ended so: solved, survives, interrupted, damaged, ..."
    )
    tags: list[str] | None = option(
        None, "--tag", metavar="WORD", help="Those marked so; several: with all of them."
    )
    since: str | None = option(
        None,
        "--since",
        metavar="WHEN",
        help="Those since a date, 2026-01-31, or of the last 2h, 7d.",
    )
    last: int | None = option(None, "--last", "-n", min=1, metavar="N", help="The last N of them.")

    @property
    def named_runs(self) -> list[str]:
        """Runs that are shown, as they were named."""
        return [] if self.run is None else [self.run]


def check(options: RunsOptions) -> Asked:
    """Read the run that was asked for, None for all; and since when."""
    from ocp.errors import InputError

    narrowed = sorted(options.given & {*FILTERS, "tags", "since", "last"})
    if options.run is not None and narrowed:
        raise InputError(f"one run is shown whole; drop --{narrowed[0].replace('tags', 'tag')}")
    since = None if options.since is None else moment(options.since)
    return (None if options.run is None else stored(options.run, options.out)), since


def moment(text: str) -> datetime:
    """Read ``2h`` (ago), or a date or time in ISO form, which is UTC where it says no zone.

    Raises :class:`~ocp.errors.InputError` for anything else.
    """
    from ocp.errors import InputError

    if match := re.fullmatch(r"(\d{1,6})([smhdw])", text, re.ASCII):
        return datetime.now(UTC) - timedelta(seconds=int(match[1]) * _SECONDS[match[2]])
    try:
        found = datetime.fromisoformat(text)
    except ValueError:
        raise InputError(
            f"--since must be a date such as 2026-01-31, or a time ago such as 30m, 2h, 7d, got"
            f" {text!r}"
        ) from None
    return found if found.tzinfo else found.replace(tzinfo=UTC)


def run(options: RunsOptions, asked: Asked) -> int:
    """List the stored runs, the latest last, or show one.

    The number before a run is how a command may call it: @1, or @last, is the latest of all.
    """
    from reports.console import print_table
    from reports.stored_tables import run_table

    one, since = asked
    if one is not None:
        options.output.document({"run": str(one.path), **one.meta})
        if not options.as_json:
            print_table(run_table(one))
        return 0
    every = listing(options.out)
    entries = [entry for entry in every if _asked_for(options, since, entry)]
    entries = entries[-options.last :] if options.last else entries
    options.output.document({"runs": entries})
    if not options.as_json:
        _print(options, entries, every)
    return 0


def _print(
    options: RunsOptions, entries: list[dict[str, Any]], every: list[dict[str, Any]]
) -> None:
    from ocp.store.parts import visible
    from reports.cli.stored.listing import lines, values

    if entries:
        # Folders may be called anything.
        print("\n".join(lines(visible(entries))))
    elif every:
        print(f"none of the {len(every)} runs in {options.out} is like that; there are:")
        for key in FILTERS:
            print(f"  {key}: {', '.join(values(every, key))}")
    else:
        print(f"{options.out} holds no runs; ocp solve PROBLEM makes one")


def _asked_for(options: RunsOptions, since: datetime | None, entry: dict[str, Any]) -> bool:
    for key in FILTERS:
        wanted = getattr(options, key)
        known = (entry[key], entry["grade"]) if key == "status" else (entry[key],)
        if wanted is not None and wanted not in known:
            return False
    if not set(options.tags or ()) <= set(entry["tags"]):
        return False
    created = entry["created"]
    return since is None or (created is not None and datetime.fromisoformat(created) >= since)


def stored(text: str, root: Path) -> StoredRun:
    """Read the run that ``text`` names; raises as ``store.find`` and ``store.load`` do."""
    from ocp import store

    return store.load(store.find(text, root))


def listing(root: Path) -> list[dict[str, Any]]:
    """Return one object a run, oldest first: at (``@1`` is the latest), run, problem, ...."""
    from ocp import store

    entries = store.list_runs(root)
    return [_row(entry, f"@{len(entries) - place}") for place, entry in enumerate(entries)]


def _row(entry: Any, at: str) -> dict[str, Any]:
    meta = entry.meta or {}
    record = meta.get("record") or {}
    params = record.get("params") or {}
    return {
        "at": at,
        "run": str(entry.path),
        "problem": meta.get("problem", entry.path.parent.name),
        **{key: meta.get(key) for key in ("kind", "created", "hash", "cost", "grade")},
        "status": "damaged" if entry.damage else meta.get("status"),
        "tags": meta.get("tags") or [],
        **{key: record.get(key) for key in ("contact", "contact_settings", "method", "policy",
                                            "algorithm")},
        "N": record.get("N"),
        "scenarios": params.get("scenarios", 1) if "N" in record else None,
        **{key: meta.get(key) for key in ("seed", "return", "verdict", "over")},
        "damage": entry.damage or None,
    }  # fmt: skip


COMMAND = Command(
    RunsOptions, check, run,
    examples=(
        "runs", "runs @last", "runs --problem push-disc --contact barrier --since 2h",
        "runs --tag paper --status survives --json", "runs rm @2",
        "runs export @last -o motion.csv",
    ),
)  # fmt: skip
