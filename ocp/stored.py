"""A stored run as the solution it was."""

from __future__ import annotations

import warnings
from pathlib import Path

from ocp.plugins import load_plugin
from ocp.problem import Problem
from ocp.solution import Solution


def load(
    run: Path | str,
    problem: Problem | None = None,
    root: Path | str | None = None,
    source: Path | str | None = None,
) -> Solution:
    """Read a run of ``ocp solve``, or of :meth:`Solution.save`.

    ``run`` is its directory, part of its name in the store ``root``, or ``@last``, as the command
    line takes it (:func:`~ocp.store.lookup.find`). Its problem is built again by its name. Of a
    problem of one's own ``source`` names the file, for code that a run names is never loaded; or
    ``problem`` is what was built of it, or without a file. Warns where the file has changed.

    Raises :class:`~ocp.errors.InputError` where there is no such run, it is no solve, or its
    problem is not found again, and :class:`~ocp.errors.DamagedRun` where it is not whole.
    """
    from ocp import store

    found = store.load(store.find(str(run), root))
    if problem is not None:
        return found.solution(problem)
    problems = load_plugin("problems")
    own = problems.named_file(source, [found])
    if told := problems.edited(found, own):
        warnings.warn(told, stacklevel=2)
    return found.solution(problems.problem_of(found, own)[2])
