"""Request of a solve: a problem by name, file or object, keywords, and ``-s`` settings."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from os import PathLike, fspath
from typing import Any, TypeAlias

from dynamics.contact import ContactLaw
from dynamics.settings import Configured, parse_float, parse_int, setting, settings_of
from ocp import plugins
from ocp.errors import InputError, choose, did_you_mean
from ocp.problem.problem import Problem
from ocp.programs.options import documented, has_option
from ocp.programs.solver import SOLVERS
from ocp.routes.relaxations import DEFAULT_STRATEGY, STRATEGIES
from ocp.transcription.factories import law_settings, laws_with

ProblemSource: TypeAlias = Any
"""Builder of a problem at any parameter values, a :class:`problems.ProblemSpec`."""
ProblemLike = Problem | ProblemSource | str | PathLike[str]
"""A problem, a :class:`problems.ProblemSpec`, its ``Params``, a registered name, or the path of a file."""


def resolve_problem(
    problem: ProblemLike,
    contact: ContactLaw | str,
    params: Mapping[str, Any] | None,
    contact_settings: Mapping[str, Any] | None,
    keywords: Mapping[str, Any],
    solver: str,
) -> tuple[Problem, dict[str, Any]]:
    """Return the problem at its parameter values, and a dict of the law's settings.

    Each of ``keywords`` is a parameter of the problem or a setting of the law.

    Raises :class:`~ocp.errors.InputError` for a keyword that neither or both of them have, or that is also in
    ``params`` or ``contact_settings``, and for parameters if ``problem`` is already built.
    """
    if hasattr(type(problem), "model_fields"):
        problem = plugins.problems.get(problem)
    source = problem if isinstance(problem, Problem) else _source(problem)
    for_problem, for_law = split_keywords(source, contact, params, contact_settings, keywords, solver)
    if not isinstance(source, Problem):
        return source.problem(for_problem), for_law
    if for_problem:
        raise InputError(
            f"{', '.join(for_problem)} cannot be set: {source.name} is already built; give"
            " parameters to problems.get, or name the problem here"
        )
    return source, for_law


def rebuilder(problem: ProblemLike) -> Callable[[Problem, dict[str, Any]], Problem]:
    """Return a function ``(problem, values) -> Problem`` that rebuilds the problem with other parameter values.

    For a problem object only N and the recorded settings can change; a named problem is built again from its
    parameters.
    """

    def build(built: Problem, changed_values: dict[str, Any]) -> Problem:
        if not isinstance(problem, Problem):
            built_settings = {name: changed_values.get(name, v) for name, v in built.origin.settings.items()}
            built_values = zip(built.parameters.names, built.parameters.values.tolist(), strict=True)
            return _source(problem).problem({**dict(built_values), **built_settings, **changed_values})
        settings = built.origin.settings
        settings = {name: changed_values.get(name, value) for name, value in settings.items()}
        return replace(built, N=changed_values["N"], origin=replace(built.origin, settings=settings))

    return build


def split_keywords(
    source: Problem | ProblemSource,
    contact: ContactLaw | str,
    params: Mapping[str, Any] | None,
    contact_settings: Mapping[str, Any] | None,
    keywords: Mapping[str, Any],
    solver: str,
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the parameters of the problem and the settings of the law; raise as :func:`resolve_problem` does."""
    takes = () if isinstance(source, Problem) else tuple(source.Params.model_fields)
    for_problem, for_law = dict(params or {}), dict(contact_settings or {})
    settings = law_settings(contact)
    for key, value in keywords.items():
        owned = (key in takes, key in settings)
        if all(owned):
            raise InputError(
                f"{key} is a parameter of {source.name} and a setting of the {contact} law; say"
                f" params={{{key!r}: ...}} or contact_settings={{{key!r}: ...}}"
            )
        if not any(owned):
            raise InputError(_unknown_keyword(key, source, contact, takes, settings, solver))
        target = for_problem if owned[0] else for_law
        if key in target:
            raise InputError(f"{key} is given twice; give it once")
        target[key] = value
    return for_problem, for_law


def check_setting_names(settings: Mapping[str, Any], solver: str) -> None:
    """Raise :class:`~ocp.errors.InputError` for a setting that neither ``ocp solve`` nor the solver has.

    The message suggests the nearest name, and says how to list all names.
    """
    choose("solver", solver, SOLVERS)
    for key in sorted(set(settings) - set(SOLVE_SETTINGS)):
        option = key.removeprefix("ipopt.")
        if not has_option(solver, option):
            known_names = [*SOLVE_SETTINGS, *documented(solver)]
            raise InputError(
                f"unknown setting {key!r}{did_you_mean(option, known_names)}; there are"
                f" {', '.join(SOLVE_SETTINGS)}, policy.<name>, and the options of {solver}: list them with ocp"
                f" settings and ocp settings {solver}"
            )


def _source(problem: ProblemSource | str | PathLike[str]) -> ProblemSource:
    if isinstance(problem, str | PathLike):
        return plugins.problems.source(fspath(problem))
    if not hasattr(problem, "problem"):
        raise InputError(f"a problem is a name, a file or an ocp.Problem, got {type(problem).__name__}")
    return problem


def _unknown_keyword(
    key: str,
    source: Problem | ProblemSource,
    contact: ContactLaw | str,
    takes: tuple[str, ...],
    settings: tuple[str, ...],
    solver: str,
) -> str:
    """Return the error message for a keyword that neither the problem nor the law has."""
    if key.startswith("policy") or key in SOLVE_SETTINGS or has_option(solver, key):
        return f"{key} is not an argument of solve; use settings={{{key!r}: ...}}"
    built_parts = [
        f"the {part_name} is already built; pass {key} to {constructor}"
        for part_name, constructor, is_made in (
            ("problem", "problems.get", isinstance(source, Problem)),
            ("law", f"{type(contact).__name__}(...)", isinstance(contact, ContactLaw)),
        )
        if is_made
    ]
    accepted_names = [
        f"{owner} takes {', '.join(names) or 'none'}"
        for owner, names, is_made in (
            (f"the {contact} law", settings, isinstance(contact, ContactLaw)),
            (source.name, takes, isinstance(source, Problem)),
        )
        if not is_made
    ]
    return (
        f"solve has no argument {key!r}{did_you_mean(key, (*settings, *takes))};"
        f" {'; '.join([*accepted_names, *built_parts])}{'' if isinstance(contact, ContactLaw) else laws_with(key)}"
    )


@dataclass(frozen=True)
class Settings(Configured):
    """Validated settings of a solve; ``options`` belong to the solver, which checks them."""

    homotopy: bool | None = setting(
        None,
        "follow the law's smoothing parameter from a large initial value; default: if the law smooths. Exact"
        " law in shooting: true follows the barrier law down, false is the gradient method alone,"
        " not given rolls out the plan of the direct transcription",
    )
    strategy: str = setting(
        DEFAULT_STRATEGY,
        "strategy of direct transcription for exact complementarity; see ocp settings strategies",
        words=tuple(STRATEGIES),
    )
    factor: float | None = setting(
        None, "factor of the homotopy's parameter per stage; not given: the law's", above=0, below=1
    )
    homotopy_start: float | None = setting(
        None, "first value of the homotopy's parameter; not given: from the sizes of the problem", above=0
    )
    jit: bool = setting(False, "evaluate by compiled C, cached, where a compiler is found")
    options: dict[str, Any] = field(default_factory=dict)

    def changed(self) -> dict[str, Any]:
        """Return a dict of the settings that differ from their defaults, including the solver's options."""
        values = {key: getattr(self, key) for key in SOLVE_SETTINGS}
        changed = {key: value for key, value in values.items() if value != SOLVE_SETTINGS[key].default}
        return {**changed, **self.options}

    @classmethod
    def read(cls, raw: Mapping[str, Any]) -> Settings:
        """Return the settings in a dict of strings or values; raise :class:`~ocp.errors.InputError` for bad values."""
        values = {key: about.read(raw[key], "setting ") for key, about in SOLVE_SETTINGS.items() if key in raw}
        options = {k.removeprefix("ipopt."): literal(v) for k, v in raw.items() if k not in SOLVE_SETTINGS}
        return cls(**values, options=options)


SOLVE_SETTINGS = settings_of(Settings)
"""Mapping from the name of each setting of a solve to its description, without the solver's options."""


def literal(value: Any) -> Any:
    """Return a string as an int, float or bool if it can be read as one (:mod:`dynamics.settings`), else unchanged."""
    if not isinstance(value, str):
        return value
    if (number := parse_float(value)) is not None:
        return parse_int(value) if value.strip().lstrip("+-").isdigit() else number
    return {"true": True, "false": False}.get(value.lower(), value)
