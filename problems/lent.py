"""What this floor lends to the one below by entry points (:mod:`ocp.floors`)."""

from __future__ import annotations

from typing import Any

from ocp.errors import InputError
from ocp.problem import Problem
from ocp.store.stored_run import StoredRun
from problems.objectives import objective_names
from problems.registry import spec
from problems.spec import ProblemSpec, Spec


def source(name: str) -> ProblemSpec:
    """Return the problem called ``name``, or that of a file.

    Raises :class:`~ocp.errors.InputError` for a name that is neither, or an objective's.
    """
    if name in objective_names():
        raise InputError(
            f"{name} is an objective without dynamics, nothing to solve; its gradients are"
            f" estimated: ocp estimate {name}"
        )
    return spec(name)


def problem_of(run: StoredRun) -> tuple[ProblemSpec, Any, Problem]:
    """Return a run's spec, its parameters and the problem, built again.

    Raises :class:`~ocp.errors.InputError` where the problem's file is gone or no longer fits.
    """
    found = spec(run.record.get("source") or run.meta["problem"])
    given = known_parameters(run, found)
    return found, found.params(given), found.problem(given)


def known_parameters(run: StoredRun, found: Spec) -> dict[str, Any]:
    """Parameters of a run that its spec still has."""
    known = found.Params.model_fields
    return {k: v for k, v in run.record.get("params", {}).items() if k in known}
