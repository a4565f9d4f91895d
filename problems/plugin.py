"""Functions that :mod:`ocp` loads from this package by entry point (:mod:`ocp.plugins`)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dynamics.contact import ContactLaw
from dynamics.systems import ContactSystem
from ocp.errors import InputError
from ocp.problem.problem import Problem
from ocp.store.stored_run import StoredRun
from ocp.transcription.factories import law_class, make_law
from problems.registry import get as get
from problems.registry import load, names, objective_names, registered, spec
from problems.registry import load_law as load_law
from problems.registry import named as named
from problems.spec import ProblemSpec, Spec

if TYPE_CHECKING:
    from ocp.solution import Solution
    from problems.gradient_scenes.cases import GradientCase


def source(name: str) -> ProblemSpec:
    """Return the problem called ``name``, or the problem that the file ``name`` defines.

    Raises :class:`~ocp.errors.InputError` if there is no such problem or file, or if it is an objective.
    """
    if name in objective_names():
        raise InputError(
            f"{name} is an objective without dynamics, nothing to solve; its gradients are"
            f" estimated: ocp estimate {name}"
        )
    return spec(name)


def gradient_case(
    source: str | Solution,
    worlds: Sequence[str] = (),
    settings: Mapping[str, float] | None = None,
    parameter: int = 0,
    output: int = 0,
    seed: int = 0,
) -> GradientCase:
    """Return the derivatives to be judged and the simulators of a scene, a file or a plan.

    Raises the errors of :func:`problems.gradient_scenes.cases.gradient_case`.
    """
    from problems.gradient_scenes.cases import gradient_case

    return gradient_case(source, worlds, settings, parameter, output, seed)


def named_file(source: Path | str | None, runs: Sequence[StoredRun]) -> ProblemSpec | None:
    """Return the problem in the user's file ``source`` from which ``runs`` were made; None if ``source`` is None.

    Raises :class:`~ocp.errors.InputError` if the file cannot be read, or if none of the runs is of its problem.
    """
    if source is None:
        return None
    user_problems = sorted({str(run.meta["problem"]) for run in runs if _is_user_problem(run)})
    if not user_problems:
        problem_names = ", ".join(sorted({str(run.meta["problem"]) for run in runs}))
        raise InputError(f"--source: {problem_names} is not defined in a file; drop --source")
    spec = load(source)
    if spec.name not in user_problems:
        raise InputError(
            f"--source {source} defines {spec.name}, and the run is of {', '.join(user_problems)}; name"
            " the file of that problem"
        )
    return spec


def edited(run: StoredRun, file_spec: ProblemSpec | None) -> str | None:
    """Return a warning if the user's file of the problem has changed since the run was stored, else None."""
    if file_spec is None or file_spec.name != run.meta["problem"]:
        return None
    if file_spec.digest == run.meta.get("source_digest"):
        return None
    return (
        f"{file_spec.path or file_spec.name}, or what it imports, has changed since {run.path.name} was stored;"
        " the current file is used"
    )


def law_of(
    run: StoredRun, contact: str | None, settings: Mapping[str, Any], system: ContactSystem
) -> tuple[ContactLaw, str | None]:
    """Return the law called ``contact``, and a warning if its file has changed since the run, else None.

    If ``contact`` is None, the law of the run is returned, with the settings stored in the run unless ``settings``
    are given.

    Raises :class:`~ocp.errors.InputError` if the law is from a user's file and no file is named.
    """
    record, digest = run.record, run.record.get("contact_digest")
    name = str(record.get("contact")) if contact is None else contact
    if digest is not None and name == record["contact"]:
        raise InputError(
            f"{name} is the law of the file {record['contact_source']}, and a run never loads code"
            " by itself; name the file with --contact FILE"
        )
    file_law = digest is not None and name.endswith(".py") and law_class(name).name
    if not settings and (contact is None or file_law == record.get("contact")):
        settings = record.get("contact_settings") or {}
    law = make_law(name, settings, system)
    if file_law != record.get("contact") or law.source_digest == digest:
        return law, None
    changed = f"{law.source}, or what it imports, has changed since {run.path.name} was stored"
    return law, f"{changed}; the current file is used"


def spec_of(run: StoredRun, file_spec: ProblemSpec | None = None) -> ProblemSpec:
    """Return the specification of a run's problem: a problem of the workbench, or ``file_spec`` from a user's file.

    The file whose path is stored in the run is never loaded unless the user names it. Raises
    :class:`~ocp.errors.InputError` if the run's problem is neither of the workbench nor ``file_spec``.
    """
    name = str(run.meta["problem"])
    if not _is_user_problem(run):
        return registered(name)
    if file_spec is not None and file_spec.name == name:
        return file_spec
    file = run.record.get("source")
    origin = f"the file {file}" if file else "a problem built in Python"
    raise InputError(
        f"the run of {name} is of {origin}, and a run never loads code on its own; name the file"
        " that defines it with --source FILE (in Python source=, or problem=)"
    )


def _is_user_problem(run: StoredRun) -> bool:
    """Return whether the problem of a run comes from a user's file or was built in Python."""
    name = run.meta["problem"]
    ships_with_the_workbench = run.kind in ("train", "figure") or name in names() or name in objective_names()
    return bool(run.record.get("source")) or not ships_with_the_workbench


def problem_of(run: StoredRun, file_spec: ProblemSpec | None = None) -> tuple[ProblemSpec, Any, Problem]:
    """Return the specification, the parameters, and the rebuilt problem of a run.

    Raises :class:`~ocp.errors.InputError` as :func:`spec_of` does, and if the problem cannot be built.
    """
    problem_spec = spec_of(run, file_spec)
    values = known_parameters(run, problem_spec)
    problem = problem_spec.problem(values)
    return problem_spec, problem_spec.params(values), problem.most_exact if run.record.get("most_exact") else problem


def known_parameters(run: StoredRun, problem_spec: Spec) -> dict[str, Any]:
    """Return the stored parameters of a run that its problem's specification still defines."""
    field_names = problem_spec.Params.model_fields
    return {k: v for k, v in run.record.get("params", {}).items() if k in field_names}
