"""Problems of strangers with their files, and the best known plans for them."""

from __future__ import annotations

import importlib.util
import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from types import ModuleType

import numpy as np

from ocp.store.atomic import write_file

ROOT = Path(__file__).parents[3]
"""Folder that paths of problems are relative to."""
STRANGERS = ROOT / "tests" / "strangers"
"""Folder of the thirty problem files, one folder a theme."""
NAMED = ("push-box", "push-t")
"""Named problems in addition to the files, on which the default command is known to be poor."""
BEST_KNOWN = Path(__file__).parent / "best_known.json"
"""Best known plans, the ways to them, and what the default command gave at first."""


DIGITS = 10
"""Digits of a stored input: unstable plans need more than are printed."""


@dataclass(frozen=True)
class Plan:
    """A known plan: its ``cost`` under the exact law, the ``command`` that found it, and its inputs (N, nu).

    ``start`` (nx,) is the initial state where the plan chooses it.
    """

    cost: float
    command: str
    inputs: list[list[float]]
    start: list[float] | None = None


def rounded(values: np.ndarray) -> list:
    """Return an array as lists of numbers that are short to store."""
    return np.vectorize(lambda value: float(f"{value:.{DIGITS}g}"))(values).tolist()


def problem_files() -> dict[str, Path]:
    """Return the file of every stranger by its stem, in the order of the folders."""
    files = sorted(STRANGERS.glob("*/*.py"))
    return {file.stem: file for file in files}


def problem_names() -> list[str]:
    """Return all strangers and the additional named problems."""
    return [*problem_files(), *NAMED]


def source_of(name: str) -> str:
    """Return the argument of ``ocp solve``: the path of a file, relative to the root, or a name."""
    file = problem_files().get(name)
    return name if file is None else str(file.relative_to(ROOT))


def module_of(name: str) -> ModuleType:
    """Return the module of a stranger, for its ``Params`` and ``reached``."""
    spec = importlib.util.spec_from_file_location(name, problem_files()[name])
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def stored() -> dict[str, dict]:
    """Return the file of best known plans by problem: ``known``, costs with commands, ``plan``, ``before``.

    ``known`` is in the order in which they were found, the last one the cheapest.
    """
    return json.loads(BEST_KNOWN.read_text(encoding="utf-8")) if BEST_KNOWN.exists() else {}


def best_plan(name: str) -> Plan | None:
    """Return the cheapest known plan, None if there is none."""
    entry = stored().get(name, {})
    if "known" not in entry:
        return None
    return Plan(**entry["known"][-1], **entry["plan"])


def keep_better(name: str, plans: Iterable[Plan]) -> Plan | None:
    """Append the cheapest of the ``plans`` if it is cheaper than all known ones; return it, or None."""
    known = best_plan(name)
    better = min((plan for plan in plans if np.isfinite(plan.cost)), key=lambda plan: plan.cost, default=None)
    if better is None or (known is not None and better.cost >= known.cost - 1e-6 * abs(known.cost)):
        return None
    entry = {key: value for key, value in asdict(better).items() if value is not None}
    found = {key: entry.pop(key) for key in ("cost", "command")}
    change_entry(name, known=[*stored().get(name, {}).get("known", []), found], plan=entry)
    return better


def change_entry(name: str, **fields: object) -> None:
    """Store ``fields`` of one problem, with one line per field."""
    entries = stored()
    entries[name] = {**entries.get(name, {}), **fields}
    ordered = {known: entries[known] for known in problem_names() if known in entries}
    problems = []
    for known, entry in ordered.items():
        rows = ",\n".join(f"  {json.dumps(key)}: {json.dumps(value)}" for key, value in entry.items())
        problems.append(f"{json.dumps(known)}: {{\n{rows}\n}}")
    write_file(BEST_KNOWN, ("{\n" + ",\n".join(problems) + "\n}\n").encode())
