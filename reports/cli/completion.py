"""Words that the shell proposes after Tab: problems, laws, methods, settings, figures and runs."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import typer

Words = Iterable[str]


def of_field(name: str) -> Callable[[typer.Context, str], list[str]] | None:
    """The completion of the option or argument called ``name``, None where there is none."""
    find = _WORDS.get(name)
    if find is None:
        return None

    def complete(ctx: typer.Context, incomplete: str) -> list[str]:
        # A message would go into the command line.
        try:
            return [word for word in find(ctx.params) if word.startswith(incomplete)]
        except Exception:
            return []

    return complete


def _problems(given: dict[str, Any]) -> Words:
    from problems.registry import names, objective_names

    return [*names(), *objective_names()]


def _laws(given: dict[str, Any]) -> Words:
    from dynamics.laws import LAWS

    return LAWS


def _law_settings(given: dict[str, Any]) -> Words:
    from ocp.factories import DEFAULT_LAW, law_settings

    return [f"{name}=" for name in law_settings(given.get("contact") or DEFAULT_LAW)]


def _parameters(given: dict[str, Any]) -> Words:
    from problems.registry import registered

    # A file of the user's is not run to complete a word.
    return [f"{name}=" for name in registered(given["problem"]).Params.model_fields]


def _methods(given: dict[str, Any]) -> Words:
    from ocp.transcription import METHODS

    return METHODS


def _policies(given: dict[str, Any]) -> Words:
    from ocp.policy import POLICIES

    return POLICIES


def _settings(given: dict[str, Any]) -> Words:
    from ocp.programs.options import documented
    from ocp.request import OWN

    return [f"{name}=" for name in (*OWN, *documented(given.get("solver") or "ipopt"))]


def _phases(given: dict[str, Any]) -> Words:
    from ocp.mpc.phases.table import PHASES

    return PHASES


def _plants(given: dict[str, Any]) -> Words:
    from ocp.mpc.plants import PLANTS

    return PLANTS


def _worlds(given: dict[str, Any]) -> Words:
    from ocp.worlds import WORLDS

    return WORLDS


def _figures(given: dict[str, Any]) -> Words:
    from problems.studies import ids

    return ids()


def _runs(given: dict[str, Any]) -> Words:
    from ocp.store.runs import list_runs

    return ["@last", *(entry.path.name for entry in list_runs(given.get("out") or "runs"))]


def _runs_or_problems(given: dict[str, Any]) -> Words:
    return [*_problems(given), *_runs(given)]


_WORDS: dict[str, Callable[[dict[str, Any]], Words]] = {
    "problem": _problems, "contact": _laws, "law": _laws, "law_settings": _law_settings,
    "params": _parameters, "method": _methods, "policy": _policies, "settings": _settings,
    "figures": _figures, "run": _runs, "runs": _runs, "start": _runs, "at": _runs,
    "what": _runs_or_problems, "phase": _phases, "plant": _plants, "mismatch": _parameters,
    "world": _worlds,
}  # fmt: skip
"""What completes the field of a command's options."""
