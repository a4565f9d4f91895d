"""``ocp runs [RUN]``, ``ocp runs rm``, ``ocp runs export``: list, delete and export stored runs."""

from __future__ import annotations

import re
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from ocp import store
from ocp.errors import InputError, choose
from ocp.store.lookup import check_removable, find_run, remove_runs
from ocp.store.run_files import escape_controls
from ocp.store.stored_run import EXPORT_FORMATS, StoredRun, check_csv_rows
from reports.cli.options.store import RmOptions, RunsExportOptions, RunsOptions
from reports.cli.request import check_output_file
from reports.tables.console import print_table
from reports.tables.listings import run_lines, run_table

FILTERS = ("problem", "kind", "contact", "method", "algorithm", "status")
"""Options that filter the listing, named like the keys of its rows."""
_SHOWN = 100
"""Maximum number of runs that are listed by default."""
_SECONDS_PER_UNIT = {"s": 1, "m": 60, "h": 3600, "d": 86400, "w": 7 * 86400}
"""Mapping from units of an age to seconds."""


RunsRequest = tuple[StoredRun | None, datetime | None]


def check(options: RunsOptions) -> RunsRequest:
    """Return the requested run and the date of ``--since``; None for each if it is not given."""
    narrowed = sorted(options.explicit & {*FILTERS, "tags", "since", "last"})
    if options.run is not None and narrowed:
        raise InputError(f"a single run takes no filter; drop --{narrowed[0].replace('tags', 'tag')}")
    since = None if options.since is None else parse_date(options.since)
    return (None if options.run is None else options.stored(options.run)), since


def parse_date(text: str) -> datetime:
    """Return the date for an age such as ``2h``, or for an ISO date or time, in UTC unless it has a time zone.

    Raises :class:`~ocp.errors.InputError` for anything else.
    """
    if match := re.fullmatch(r"(\d{1,6})([smhdw])", text, re.ASCII):
        return datetime.now(UTC) - timedelta(seconds=int(match[1]) * _SECONDS_PER_UNIT[match[2]])
    try:
        date = datetime.fromisoformat(text)
    except ValueError:
        raise InputError(
            f"--since must be a date such as 2026-01-31, or an age such as 30m, 2h, 7d, got {text!r}"
        ) from None
    return date if date.tzinfo else date.replace(tzinfo=UTC)


def run(options: RunsOptions, request: RunsRequest) -> int:
    """List the stored runs, the latest last, or show one."""
    single_run, since = request
    if single_run is not None:
        options.output.document({"run": str(single_run.path), **single_run.meta})
        if not options.as_json:
            print_table(run_table(single_run))
        return 0
    paths, entries, other_runs = store.run_paths(options.out), [], []
    for number, path in enumerate(reversed(paths), 1):
        row = _row(store.read_entry(path), f"@{number}")
        (entries if _matches(options, since, row) else other_runs).append(row)
        if len(entries) == (options.last or _SHOWN):
            break
    entries.reverse()
    older = len(paths) - len(entries) - len(other_runs)
    options.output.document({"runs": entries, "older": older})
    if not options.as_json:
        _print(options, entries, other_runs)
        if older and options.last is None:
            print(f"{older} older runs were not read; list all with -n {len(paths)}")
    return 0


def _print(options: RunsOptions, entries: list[dict[str, Any]], all_entries: list[dict[str, Any]]) -> None:
    if entries:
        # Names of folders may contain control characters.
        print("\n".join(run_lines(escape_controls(entries))))
    elif all_entries:
        print(f"No run matches ({len(all_entries)} in {options.out}). Available:")
        for key in FILTERS:
            names = ("status", "grade") if key == "status" else (key,)
            choices = {str(row[name]) for row in all_entries for name in names if row[name] is not None}
            print(f"  {key}: {', '.join(sorted(choices))}")
    else:
        print(f"{options.out} has no runs; ocp solve PROBLEM stores one")


def _matches(options: RunsOptions, since: datetime | None, entry: dict[str, Any]) -> bool:
    for key in FILTERS:
        expected = getattr(options, key)
        stored_values = (entry[key], entry["grade"]) if key == "status" else (entry[key],)
        if expected is not None and expected not in stored_values:
            return False
    if not set(options.tags or ()) <= set(entry["tags"]):
        return False
    created = entry["created"]
    return since is None or (created is not None and datetime.fromisoformat(created) >= since)


def _row(entry: Any, alias: str) -> dict[str, Any]:
    meta = entry.meta or {}
    record = meta.get("record") or {}
    params = record.get("params") or {}
    return {
        "at": alias,
        "run": str(entry.path),
        "problem": meta.get("problem", entry.path.parent.name),
        **{key: meta.get(key) for key in ("kind", "created", "hash", "cost", "grade")},
        "status": "damaged" if entry.damage else meta.get("status"),
        "tags": meta.get("tags") or [],
        **{key: record.get(key) for key in ("contact", "contact_settings", "method", "policy", "algorithm")},
        "N": record.get("N"),
        "scenarios": params.get("scenarios", 1) if "N" in record else None,
        **{key: meta.get(key) for key in ("seed", "return", "verdict", "over")},
        "damage": entry.damage or None,
    }


def check_rm(options: RmOptions) -> list[Path]:
    """Return the folders of the runs; raises InputError for a folder that is not a run."""
    run_paths = [find_run(text, options.out) for text in options.runs]
    for path in run_paths:
        check_removable(path)
    return run_paths


def run_rm(options: RmOptions, run_paths: list[Path]) -> int:
    """Delete stored runs, even damaged runs; nothing is deleted if any of the names is not a run."""
    remove_runs(run_paths)
    for path in run_paths:
        options.output.say(f"removed: {path}")
    options.output.document({"removed": [str(path) for path in run_paths]})
    return 0


def check_export(options: RunsExportOptions) -> tuple[StoredRun, str]:
    """Return the run and the chosen format, after a check that the run can be written in it."""
    check_output_file(options.file, "data")
    file_format = options.form or options.file.suffix.removeprefix(".").lower()
    choose("format", file_format, EXPORT_FORMATS)
    stored_run = options.stored(options.run)
    if file_format == "csv":
        check_csv_rows(stored_run)
    return stored_run, file_format


def run_export(options: RunsExportOptions, request: tuple[StoredRun, str]) -> int:
    """Write the arrays of a stored run to a file for other programs."""
    stored_run, file_format = request
    EXPORT_FORMATS[file_format](stored_run, options.file)
    options.output.say(f"{file_format}: {options.file}")
    options.output.document({"file": str(options.file), "format": file_format, "run": str(stored_run.path)})
    return 0
