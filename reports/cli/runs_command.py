"""``ocp runs [RUN]``: what the store holds."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from reports.cli.common import Debug, Json, Out, Output, Quiet


def run(
    run: Annotated[str | None, typer.Argument(help="A run: its path, or part of its name.")] = None,
    out: Out = Path("runs"),
    as_json: Json = False,
    quiet: Quiet = False,
    debug: Debug = False,
) -> int:
    """List the stored runs, or show one."""
    from reports.console import print_table, run_table, runs_table

    output = Output(as_json, quiet)
    if run is not None:
        from ocp import store

        stored = store.load(find(run, out))
        output.document({"run": str(stored.path), **stored.meta})
        if not as_json:
            print_table(run_table(stored))
        return 0
    entries = listing(out)
    output.document({"runs": entries})
    if not as_json:
        if entries:
            print_table(runs_table(entries))
        else:
            print(f"{out} holds no runs; ocp solve PROBLEM makes one")
    return 0


def listing(root: Path) -> list[dict[str, Any]]:
    """Return one object a run: run, problem, kind, created, hash, status, cost, ..., damage."""
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
                **{key: record.get(key) for key in ("contact", "method", "policy")},
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
    from ocp.errors import InputError
    from problems.spec import did_you_mean

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
