"""Which run a person means: a path, part of a name, or how many back; and where runs are kept."""

from __future__ import annotations

import os
import re
import sys
import warnings
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path

from ocp.distribution import load_plugin
from ocp.errors import InputError, did_you_mean
from ocp.problem.problem import Problem
from ocp.solution import Solution
from ocp.store.atomic import discard
from ocp.store.run_files import DATA_FILE, META_FILE, MOST
from ocp.store.runs import load, read_entry, run_paths, save
from ocp.validation import expand_path

VARIABLE = "OCP_RUNS"
"""Environment variable that names the store where none is said."""
_COMPARED = 200
"""Latest runs among which the nearest name is looked for."""


def default_root() -> Path:
    """The store where none is said: ``$OCP_RUNS``, else ``runs`` in the working directory."""
    return expand_path(os.environ.get(VARIABLE) or "runs")


def find(text: str, root: Path | str | None = None) -> Path:
    """Return the run that ``text`` names.

    That is a path; part of a run's name in ``root`` (:func:`default_root` if not said), the latest
    of several with identical content; ``@last``, the latest of all; ``@2`` the one before it, and
    so on.

    Raises :class:`~ocp.errors.InputError` for none and for several that differ.
    """
    store = default_root() if root is None else expand_path(root)
    if not text.startswith("@") and expand_path(text).exists():
        return expand_path(text)
    runs = run_paths(store)
    if re.fullmatch(r"@(last|[1-9]\d{0,8})", text):
        return _back(text, runs, store)
    return _named(text, runs, store)


def _back(text: str, runs: Sequence[Path], store: Path) -> Path:
    back = 1 if text == "@last" else int(text[1:])
    if back > len(runs):
        holds = f"{len(runs)} run{'s' * (len(runs) != 1)}" if runs else "no runs"
        raise InputError(f"there is no run {text}: {store} holds {holds}; ocp runs lists them")
    return runs[-back]


def _named(text: str, runs: Sequence[Path], store: Path) -> Path:
    named = {f"{path.parent.name}/{path.name}": path for path in runs}
    matches = [path for name, path in named.items() if text in name]
    if matches:
        first = _content(matches[0]) if len(matches) > 1 else ""
        if all(_content(path) == first for path in matches[1:]):
            return matches[-1]
        some = ", ".join(path.name for path in matches[:3])
        raise InputError(f"{text!r} names {len(matches)} runs ({some}, ...); give more of it")
    near = did_you_mean(text, list(named)[-_COMPARED:])
    raise InputError(f"there is no run {text!r}{near}; ocp runs lists what {store} holds")


def _content(path: Path) -> str:
    """Hash of a run's content; of a damaged one its path."""
    entry = read_entry(path)
    return str(path) if entry.meta is None else entry.meta["hash"]


def check_removable(path: Path) -> None:
    """Raise :class:`~ocp.errors.InputError` unless ``path`` is a run's directory, damaged or not.

    A run holds its own files and nothing else.
    """
    if path.is_symlink():
        raise InputError(f"{path} is a symbolic link; remove the link, or name what it leads to")
    found = list(path.iterdir()) if path.is_dir() else []
    if not {file.name for file in found} & {DATA_FILE, META_FILE}:
        raise InputError(f"{path} is not a run; list the runs with ocp runs")
    own = {file.name for file in found if file.is_symlink() or not file.is_dir()} & set(MOST)
    if foreign := sorted({file.name for file in found} - own):
        raise InputError(f"{path} holds {foreign[0]}, which does not belong to a run; move it away")


def remove(paths: Iterable[Path]) -> None:
    """Delete runs, and the directory of a problem with the last of its runs.

    Raises :class:`~ocp.errors.InputError`, before anything is deleted, where one of them is none
    (:func:`check_removable`).
    """
    runs = list(dict.fromkeys(paths))
    for path in runs:
        check_removable(path)
    for path in runs:
        discard(path)
        with suppress(OSError):
            path.parent.rmdir()


def save_solution(solution: Solution, store: Path | str | None = None, tags: Sequence[str] = ()) -> Path:
    """Store a solution as ``ocp solve`` does and return the run's directory, for :func:`ocp.load`.

    ``store`` is the folder of runs, by default ``$OCP_RUNS``, else ``runs``; ``tags`` mark the run.

    Raises :class:`~ocp.errors.InputError` where ``store`` cannot be written, and for a tag that is
    no word.
    """
    folder = default_root() if store is None else store
    return save(solution, folder, ["python", Path(sys.argv[0]).name], tags).path


def load_solution(
    run: Path | str,
    problem: Problem | None = None,
    store: Path | str | None = None,
    source: Path | str | None = None,
) -> Solution:
    """Read a run of ``ocp solve``, or of :func:`ocp.save`.

    ``run`` is its directory, part of its name in the folder ``store`` of runs, or ``@last``, as the command
    line takes it (:func:`~ocp.store.lookup.find`). Its problem is built again by its name. Of a
    problem of one's own ``source`` names the file, for code that a run names is never loaded; or
    ``problem`` is what was built of it, or without a file. Warns where the file has changed.

    Raises :class:`~ocp.errors.InputError` where there is no such run, it is no solve, or its
    problem is not found again, and :class:`~ocp.errors.DamagedRun` where it is not whole.
    """
    found = load(find(str(run), store))
    if problem is not None:
        return found.solution(problem)
    problems = load_plugin("problems")
    own = problems.named_file(source, [found])
    if note := problems.edited(found, own):
        warnings.warn(note, stacklevel=2)
    return found.solution(problems.problem_of(found, own)[2])
