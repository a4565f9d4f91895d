"""Words that the shell completes after Tab: problems, laws, methods, settings, figures and runs."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from importlib import import_module
from typing import Any

import typer

Words = Iterable[str]
_NAMED = {
    "contact": "dynamics.laws:LAWS",
    "law": "dynamics.laws:LAWS",
    "method": "ocp.transcription:METHODS",
    "policy": "ocp.problem.policy:POLICIES",
    "phase": "ocp.mpc.phases:PHASES",
    "plant": "ocp.mpc.plants:PLANTS",
    "world": "ocp.simulators:SIMULATORS",
    "figures": "problems.studies:STUDIES",
}
"""Mapping from an option to ``module:table``, whose keys complete the option; only completion imports the module."""


def field_completion(name: str) -> Callable[[typer.Context, str], list[str]] | None:
    """Return the completion function of the option or argument ``name``, or None if it has no completion."""
    if name not in _WORDS and name not in _NAMED:
        return None

    def complete(ctx: typer.Context, incomplete: str) -> list[str]:
        # The shell would insert the message of an error into the command line.
        try:
            candidates = _WORDS[name](ctx.params) if name in _WORDS else _table(_NAMED[name])
            return [candidate for candidate in candidates if candidate.startswith(incomplete)]
        except Exception:
            return []

    return complete


def _table(table: str) -> Words:
    module, _, name = table.partition(":")
    return getattr(import_module(module), name)


def _problems(options: dict[str, Any]) -> Words:
    from problems.registry import names, objective_names

    return [*names(), *objective_names()]


def _law_settings(options: dict[str, Any]) -> Words:
    from ocp.transcription.factories import DEFAULT_LAW, law_settings

    return [f"{name}=" for name in law_settings(options.get("contact") or DEFAULT_LAW)]


def _parameters(options: dict[str, Any]) -> Words:
    from problems.registry import registered

    # Completion does not execute a user's problem file.
    return [f"{name}=" for name in registered(options["problem"]).Params.model_fields]


def _settings(options: dict[str, Any]) -> Words:
    from ocp.programs.options import documented
    from ocp.solve.request import SOLVE_SETTINGS

    return [f"{name}=" for name in (*SOLVE_SETTINGS, *documented(options.get("solver") or "ipopt"))]


def _runs(options: dict[str, Any]) -> Words:
    from ocp.store.runs import run_paths

    return ["@last", *(path.name for path in run_paths(options.get("out") or "runs"))]


_WORDS: dict[str, Callable[[dict[str, Any]], Words]] = {
    "problem": _problems,
    "law_settings": _law_settings,
    "params": _parameters,
    "mismatch": _parameters,
    "settings": _settings,
    "run": _runs,
    "runs": _runs,
    "start": _runs,
    "plan": _runs,
    "decision_run": _runs,
    "subject": lambda options: [*_problems(options), *_runs(options)],
}
"""Mapping from each other option to a function that returns its completions, given the options typed so far."""
