"""Lookup of stored runs by path, part of a name, or age; saving and loading of solutions; and removal of runs."""

from __future__ import annotations

import os
import re
import sys
import warnings
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path

from ocp import plugins
from ocp.errors import InputError, did_you_mean
from ocp.problem.problem import Problem
from ocp.solution import Solution
from ocp.store.atomic import remove_directory
from ocp.store.run_files import DATA_FILE, MAX_BYTES, META_FILE
from ocp.store.runs import load, read_entry, run_paths, save
from ocp.validation import expand_path

STORE_VARIABLE = "OCP_RUNS"
"""Name of the environment variable that sets the default folder of runs."""
_MAX_SUGGESTED_AMONG = 200
"""Number of latest runs whose names are searched for a suggestion when a name is misspelt."""


def default_root() -> Path:
    """Return the default folder of runs: ``$OCP_RUNS``, or ``runs`` in the working directory."""
    return expand_path(os.environ.get(STORE_VARIABLE) or "runs")


def find_run(text: str, root: Path | str | None = None) -> Path:
    """Return the path of the run that ``text`` identifies.

    ``text`` is a path; or part of the name of a run in ``root`` (default: :func:`default_root`); or ``@last``
    for the latest run, ``@2`` for the second latest, and so on. If several runs with identical content match,
    the latest is returned.

    Raises :class:`~ocp.errors.InputError` if no run matches, or if several runs with different content match.
    """
    store = default_root() if root is None else expand_path(root)
    if not text.startswith("@") and expand_path(text).exists():
        return expand_path(text)
    runs = run_paths(store)
    if re.fullmatch(r"@(last|[1-9]\d{0,8})", text):
        return _run_by_age(text, runs, store)
    return _run_by_name(text, runs, store)


def _run_by_age(text: str, runs: Sequence[Path], store: Path) -> Path:
    count = 1 if text == "@last" else int(text[1:])
    if count > len(runs):
        contents = f"{len(runs)} run{'s' * (len(runs) != 1)}" if runs else "no runs"
        raise InputError(f"there is no run {text}: {store} holds {contents}; ocp runs lists them")
    return runs[-count]


def _run_by_name(text: str, runs: Sequence[Path], store: Path) -> Path:
    runs_by_name = {f"{path.parent.name}/{path.name}": path for path in runs}
    matches = [path for name, path in runs_by_name.items() if text in name]
    if matches:
        content = _content_hash(matches[0]) if len(matches) > 1 else ""
        if all(_content_hash(path) == content for path in matches[1:]):
            return matches[-1]
        examples = ", ".join(path.name for path in matches[:3])
        raise InputError(f"{text!r} names {len(matches)} runs ({examples}, ...); give more of it")
    suggestion = did_you_mean(text, list(runs_by_name)[-_MAX_SUGGESTED_AMONG:])
    raise InputError(f"there is no run {text!r}{suggestion}; ocp runs lists what {store} holds")


def _content_hash(path: Path) -> str:
    """Return the hash of a run's content or, if the run is damaged, its path."""
    entry = read_entry(path)
    return str(path) if entry.meta is None else entry.meta["hash"]


def check_removable(path: Path) -> None:
    """Raise :class:`~ocp.errors.InputError` unless ``path`` is the directory of a run, damaged or not.

    Directories that also contain other files are rejected.
    """
    if path.is_symlink():
        raise InputError(f"{path} is a symbolic link; remove the link, or give the path of its target")
    files = list(path.iterdir()) if path.is_dir() else []
    if not {file.name for file in files} & {DATA_FILE, META_FILE}:
        raise InputError(f"{path} is not a run; list the runs with ocp runs")
    run_files = {file.name for file in files if file.is_symlink() or not file.is_dir()} & set(MAX_BYTES)
    if foreign := sorted({file.name for file in files} - run_files):
        raise InputError(f"{path} holds {foreign[0]}, which does not belong to a run; move it away")


def remove_runs(paths: Iterable[Path]) -> None:
    """Delete runs, and a problem's directory if no run is left in it.

    Raises :class:`~ocp.errors.InputError`, before anything is deleted, if a path is not a run
    (:func:`check_removable`).
    """
    runs = list(dict.fromkeys(paths))
    for path in runs:
        check_removable(path)
    for path in runs:
        remove_directory(path)
        with suppress(OSError):
            path.parent.rmdir()


def save_solution(solution: Solution, store: Path | str | None = None, tags: Sequence[str] = ()) -> Path:
    """Store a solution as ``ocp solve`` does, and return the run's directory, which :func:`ocp.load` reads.

    ``store`` is the folder of runs (default: ``$OCP_RUNS`` or ``runs``); ``tags`` are stored with the run.
    Raises :class:`~ocp.errors.InputError` if ``store`` cannot be written, and for a tag that is not a word.
    """
    folder = default_root() if store is None else store
    return save(solution, folder, ["python", Path(sys.argv[0]).name], tags).path


def load_solution(
    run: Path | str,
    problem: Problem | None = None,
    store: Path | str | None = None,
    source: Path | str | None = None,
) -> Solution:
    """Read the solution from a run of ``ocp solve`` or :func:`ocp.save`.

    ``run`` is the run's directory, part of its name in the folder ``store`` of runs, or ``@last``, as on the
    command line (:func:`~ocp.store.lookup.find_run`). A problem of the workbench is rebuilt from its name. For
    a user's problem, give its file as ``source`` or the built ``problem``, since code that is named in a run is
    never loaded. If the file has changed since the run, a warning is issued.

    Raises :class:`~ocp.errors.InputError` if there is no such run, it is not a solve, or its
    problem is not found, and :class:`~ocp.errors.DamagedRun` if it is incomplete.
    """
    stored_run = load(find_run(str(run), store))
    if problem is not None:
        return stored_run.solution(problem)
    own_problem = plugins.problems.named_file(source, [stored_run])
    if note := plugins.problems.edited(stored_run, own_problem):
        warnings.warn(note, stacklevel=2)
    return stored_run.solution(plugins.problems.problem_of(stored_run, own_problem)[2])
