"""What a solve is asked for: a problem by name, file or object, keywords, and ``-s`` settings."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from os import PathLike, fspath
from types import SimpleNamespace
from typing import Annotated, Any, TypeAlias, get_args, get_origin, get_type_hints

from pydantic import Field

from dynamics.contact import ContactLaw
from ocp.distribution import load_plugin
from ocp.errors import InputError, choose, did_you_mean
from ocp.problem.problem import Problem
from ocp.programs.options import documented, has_option
from ocp.programs.solver import SOLVERS
from ocp.routes.relaxations import DEFAULT_STRATEGY, STRATEGIES
from ocp.transcription.factories import law_settings, laws_with
from ocp.validation import parse, parse_float, parse_int

ProblemSource: TypeAlias = Any
"""What builds a problem at any parameters: a :class:`problems.ProblemSpec`."""
ProblemLike = Problem | ProblemSource | str | PathLike[str]
"""A problem, what builds one (:class:`problems.ProblemSpec`), the ``Params`` of one, a registered
name, or a file."""


def resolve_problem(
    problem: ProblemLike,
    contact: ContactLaw | str,
    params: Mapping[str, Any] | None,
    contact_settings: Mapping[str, Any] | None,
    keywords: Mapping[str, Any],
    solver: str,
) -> tuple[Problem, dict[str, Any]]:
    """Build the problem at its parameters, and collect the settings of the law.

    ``keywords`` are parameters of the problem or settings of the law, whichever has the name.

    Raises :class:`~ocp.errors.InputError` for a keyword that neither has, that both have, or that
    ``params`` or ``contact_settings`` give too, and for parameters of a problem that is built.
    """
    if hasattr(type(problem), "model_fields"):
        problem = load_plugin("problems").get(problem)
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
    """What makes a problem anew at other values by name, of the problem that was made of it."""

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
    """Parameters of the problem and settings of the law; raises as :func:`resolve_problem` does."""
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
    """Refuse a setting that is neither ours nor an option of the solver.

    Raises :class:`~ocp.errors.InputError` with the one that was meant, and where all are listed.
    """
    choose("solver", solver, SOLVERS)
    for key in sorted(set(settings) - set(OWN)):
        bare = key.removeprefix("ipopt.")
        if not has_option(solver, bare):
            known_names = [*OWN, *documented(solver)]
            raise InputError(
                f"unknown setting {key!r}{did_you_mean(bare, known_names)}; there are"
                f" {', '.join(OWN)}, policy.<name>, and the options of {solver}: list them with ocp"
                f" settings and ocp settings {solver}"
            )


def _source(problem: ProblemSource | str | PathLike[str]) -> ProblemSource:
    if isinstance(problem, str | PathLike):
        return load_plugin("problems").source(fspath(problem))
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
    """Say where a keyword belongs that neither the problem nor the law has."""
    if key.startswith("policy") or key in OWN or has_option(solver, key):
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
class Settings:
    """Validated settings; ``options`` go to the solver, which knows their types."""

    homotopy: Annotated[
        bool | None,
        "follow a law's smoothing down from a wide start; not given: where the law smooths. Exact"
        " law in shooting: true follows the barrier law down, false is the gradient method alone,"
        " not given rolls out the plan of the direct transcription",
    ] = None
    strategy: Annotated[
        str,
        f"how a direct transcription meets exact complementarity: {', '.join(STRATEGIES)}; ocp"
        " settings strategies says which for what",
    ] = DEFAULT_STRATEGY
    factor: Annotated[
        Annotated[float, Field(gt=0, lt=1, allow_inf_nan=False)] | None,
        "factor of the homotopy's parameter per stage, between 0 and 1; not given: the law's",
    ] = None
    homotopy_start: Annotated[
        Annotated[float, Field(gt=0, allow_inf_nan=False)] | None,
        "first value of the homotopy's parameter; not given: from the sizes of the problem",
    ] = None
    jit: Annotated[bool, "evaluate by compiled C, cached, where a compiler is found"] = False
    options: dict[str, Any] = field(default_factory=dict)

    def given(self) -> dict[str, Any]:
        """The settings that differ from their defaults, and the solver's options, by name."""
        defaults = Settings()
        own_settings = {key: getattr(self, key) for key in OWN}
        return {**{k: v for k, v in own_settings.items() if v != getattr(defaults, k)}, **self.options}

    @classmethod
    def read(cls, raw: Mapping[str, Any]) -> Settings:
        """Read strings (or values) by key; raises :class:`~ocp.errors.InputError`."""
        types = get_type_hints(cls, include_extras=True)
        own_settings = {key: parse(f"setting {key}", raw[key], types[key]) for key in OWN if key in raw}
        if "strategy" in own_settings:
            choose("strategy", own_settings["strategy"], STRATEGIES)
        options = {k.removeprefix("ipopt."): literal(v) for k, v in raw.items() if k not in OWN}
        return cls(**own_settings, options=options)


@dataclass(frozen=True)
class Setting:
    """A setting as it was declared: name, kind of value, default (None for none) and meaning."""

    name: str
    kind: str
    default: Any
    meaning: str


def declared(cls: type) -> list[Setting]:
    """Settings of a class: the arguments that make one and are ``Annotated`` with their meaning."""
    settings = []
    for name, argument in inspect.signature(cls).parameters.items():
        hint = _hint(cls, name)
        meanings = [word for word in getattr(hint, "__metadata__", ()) if isinstance(word, str)]
        if meanings:
            default = None if argument.default is argument.empty else argument.default
            settings.append(Setting(name, _kind(hint), default, meanings[0]))
    return settings


def _hint(cls: type, name: str) -> Any:
    """Type of an argument that makes ``cls``; None where only type checkers know it."""
    owner = next((base for base in cls.__mro__ if name in vars(base).get("__annotations__", {})), cls.__init__)
    scope = vars(sys.modules[owner.__module__])
    with suppress(NameError):
        alone = SimpleNamespace(__annotations__={name: owner.__annotations__[name]})
        return get_type_hints(alone, scope, include_extras=True)[name]
    return None


def _kind(hint: Any) -> str:
    """The first type among the alternatives of ``hint`` in words."""
    while get_origin(hint) is Annotated or (get_args(hint) and get_origin(hint) is not tuple):
        hint = get_args(hint)[0]
    words = {bool: "true or false", int: "whole number", float: "number", str: "word"}
    return words.get(hint, "whole numbers" if get_origin(hint) is tuple else "name")


OWN = {setting.name: setting.meaning for setting in declared(Settings)}
"""Our own settings of a solve, with their meanings."""


def literal(value: Any) -> Any:
    """Turn a word into an int, float or bool where it reads as one (:mod:`ocp.validation`)."""
    if not isinstance(value, str):
        return value
    if (number_value := parse_float(value)) is not None:
        is_whole = value.strip().lstrip("+-").isdigit()
        return parse_int(value) if is_whole else number_value
    return {"true": True, "false": False}.get(value.lower(), value)
