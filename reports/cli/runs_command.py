"""``ocp runs [RUN]``: what the store holds."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from reports.cli.declared import argument
from reports.cli.options import RUN, Command, StoreOptions

if TYPE_CHECKING:
    from ocp.store.stored_run import StoredRun


@dataclass(frozen=True, kw_only=True)
class RunsOptions(StoreOptions):
    """One run, or all."""

    run: str | None = argument(default=None, help=RUN)


def check(options: RunsOptions) -> StoredRun | None:
    """Read the run that was asked for; None for all."""
    return None if options.run is None else stored(options.run, options.out)


def run(options: RunsOptions, one: StoredRun | None) -> int:
    """List the stored runs, or show one."""
    from reports.console import print_table
    from reports.stored_tables import run_table, runs_table

    if one is not None:
        options.output.document({"run": str(one.path), **one.meta})
        if not options.as_json:
            print_table(run_table(one))
        return 0
    entries = listing(options.out)
    options.output.document({"runs": entries})
    if not options.as_json:
        if entries:
            print_table(runs_table(entries))
        else:
            print(f"{options.out} holds no runs; ocp solve PROBLEM makes one")
    return 0


def stored(text: str, root: Path) -> StoredRun:
    """Read the run that ``text`` names; raises as :func:`find` and ``store.load`` do."""
    from ocp import store

    return store.load(find(text, root))


def listing(root: Path) -> list[dict[str, Any]]:
    """Return one object a run: run, problem, kind, created, hash, status, cost, return, ...."""
    from ocp import store

    rows = []
    for entry in store.list_runs(root):
        meta = entry.meta or {}
        record = meta.get("record") or {}
        rows.append(
            {
                "run": str(entry.path),
                "problem": meta.get("problem", entry.path.parent.name),
                **{key: meta.get(key) for key in ("kind", "created", "hash", "status", "cost")},
                **{key: record.get(key) for key in ("contact", "method", "policy", "algorithm")},
                **{key: meta.get(key) for key in ("seed", "return")},
                "damage": entry.damage or None,
            }
        )
    return rows


def find(text: str, root: Path) -> Path:
    """Return the run that ``text`` names: a path, or part of a run's name in ``root``.

    Of several runs with identical content the latest is taken.

    Raises :class:`~ocp.errors.InputError` for none and for several that differ.
    """
    from ocp import store
    from ocp.errors import InputError, did_you_mean

    if Path(text).exists():
        return Path(text)
    entries = {f"{e.path.parent.name}/{e.path.name}": e for e in store.list_runs(root)}
    matches = [entry for name, entry in entries.items() if text in name]
    if (
        matches
        and len({entry.meta["hash"] if entry.meta else entry.path for entry in matches}) == 1
    ):
        return matches[-1].path
    if matches:
        some = ", ".join(entry.path.name for entry in matches[:3])
        raise InputError(f"{text!r} names {len(matches)} runs ({some}, ...); give more of it")
    raise InputError(
        f"there is no run {text!r}{did_you_mean(text, entries)}; ocp runs lists what {root} holds"
    )


COMMAND = Command(RunsOptions, check, run)
