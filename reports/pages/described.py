"""What every page says of a run: how it was asked for, its equations, parameters and settings."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from dynamics.laws import LAWS
from ocp.store.stored_run import StoredRun
from problems.parameters import unit_of
from problems.spec import Spec
from reports.console import number
from reports.figures.panels import COLUMNS, Row, draw_rows
from reports.notation import full_citation, plain
from reports.units import in_symbols, powers, symbol
from reports.view import RunView

if TYPE_CHECKING:
    from problems.studies.study import FigureStudy

Page = tuple[dict[str, Any], dict[str, Figure]]
_NOT_SETTINGS = (
    "params", "problem", "source", "versions", "citation", "audit_s", "N", "law_parameters",
    "sweep", "jit", "learned_at",
)  # fmt: skip
_FIRST = ("contact", "method", "policy", "solver")
_LEAST_MU = 1e-12
_UNLOADED = (
    "The file of this problem was not loaded: what is shown is what the run keeps of it. ocp report"
    " --source FILE sets its equations, and draws what only the file can."
)


def head(view: RunView) -> dict[str, Any]:
    """Title, and what :func:`described` says of the run."""
    values = view.run.record.get("params", {}) if view.spec is None else view.params.model_dump()
    return {"title": view.title, **described(view.run, view.spec, values)}


def described(
    run: StoredRun, spec: Spec | FigureStudy | None, values: dict[str, Any]
) -> dict[str, Any]:
    """Where a run is from, what was asked, and what it found."""
    cited = spec.citation if spec else None
    told = run.own_problem if spec is None else None
    return {
        "hash": run.meta["hash"],
        "verdict": run.meta["verdict"],
        "how": how(run),
        "equations": list(spec.equations) if isinstance(spec, Spec) else [],
        # What a run tells is text: typst's mathematics is a program that a page would run.
        "typed": [plain(line) for line in told["equations"]] if told else [],
        "unloaded": _UNLOADED if told else "",
        "parameters": _kept_parameters(told, values) if told else _parameters(spec, values),
        "citation": f"{cited.text}. {full_citation(cited.key)}." if cited else "",
        "settings": settings(run),
        "versions": pairs(run.meta.get("versions") or {}),
    }


def how(run: StoredRun, without: Collection[str] = ()) -> list[list[str]]:
    """Law with its settings, but ``without`` some, method, policy and solver: below the title."""
    record = run.record
    found = [["law", law_asked(run, without)]] if record.get("contact") else []
    found += [[key, str(record[key])] for key in _FIRST[1:] if record.get(key)]
    if record.get("N"):
        found.append(["steps", str(record["N"])])
    scenarios = run.data.sizes.get("scenario", 1)
    return found + ([["scenarios", str(scenarios)]] if scenarios > 1 else [])


def law_asked(run: StoredRun, without: Collection[str] = ()) -> str:
    """The law by its name and its settings, but ``without`` some: ``barrier (μ = 0.001)``."""
    name = str(run.record["contact"])
    given = {
        key: value for key, value in _law_settings(run, name).items()
        if f"contact.{key}" not in without
    }  # fmt: skip
    told = ", ".join(f"{symbol(key)} = {shown(value)}" for key, value in given.items())
    return f"{name} ({told})" if told else name


def _law_settings(run: StoredRun, name: str) -> dict[str, Any]:
    """Settings of a run's law; an estimate keeps them as they were typed, none for the defaults."""
    typed = run.record.get("law_settings")
    if typed:
        return dict(text.partition("=")[::2] for text in typed)
    known = LAWS.get(name)
    if typed is not None and known is not None:
        return known().settings()
    return run.record.get("contact_settings") or {}


def law(view: RunView) -> dict[str, Any]:
    """The law's name, what it is, and where on the central path the plan lies."""
    name = str(view.run.record.get("contact", ""))
    known = LAWS.get(name)
    return {
        "name": name,
        "summary": in_symbols(known.summary) if known else "",
        "place": _place_on_path(view.array("mu")),
    }


def _place_on_path(mu: np.ndarray | None) -> str:
    if mu is None or not np.any(np.isfinite(mu)):
        return ""
    low, high = float(np.nanmin(mu)), float(np.nanmax(mu))
    if high == 0:
        return "At the end of the central path: μ = 0, complementarity itself."
    if high - low <= 1e-9 * high:
        return f"On the central path at μ = {high:.3g} in every contact and step."
    start = f"{low:.2g}" if low >= _LEAST_MU else f"less than {_LEAST_MU:.0e}"
    return f"Near the central path: μ from {start} to {high:.2g} over contacts and steps."


def _parameters(spec: Spec | FigureStudy | None, values: dict[str, Any]) -> list[list[str]]:
    """Name, value, unit and meaning of every parameter."""
    if spec is None:
        return [[name, shown(value), "", ""] for name, value in values.items()]
    return [
        [name, shown(values[name]), powers(unit_of(about)), about.description or ""]
        for name, about in spec.Params.model_fields.items() if name in values
    ]  # fmt: skip


def _kept_parameters(told: dict[str, Any], values: dict[str, Any]) -> list[list[str]]:
    known, nothing = told["parameters"], {"unit": "", "description": ""}
    meant = {name: known.get(name, nothing) for name in values}
    return [
        [name, shown(value), powers(meant[name]["unit"]), meant[name]["description"]]
        for name, value in values.items()
    ]


def shown(value: Any) -> str:
    """A value in a line: numbers short, words of a list with commas."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, list | tuple):
        return ", ".join(shown(each) for each in value)
    return number(value, 8) if isinstance(value, int | float) else str(value)


def settings(run: StoredRun) -> list[list[str]]:
    """What was asked, but for what has its own table or line."""
    left = {key: value for key, value in run.record.items() if key not in _NOT_SETTINGS}
    return [
        row for row in pairs(left)
        if row[0] not in _FIRST and not row[0].startswith("contact.")
    ]  # fmt: skip


def pairs(values: dict[str, Any]) -> list[list[str]]:
    """Names and values as text; those of a group as ``group.name``."""
    rows = []
    for key, value in values.items():
        if isinstance(value, dict):
            group = key.removesuffix("_settings").removesuffix("_options")
            rows += [[f"{group}.{name}", text] for name, text in pairs(value)]
        elif value is not None and value != []:
            rows.append([key.replace("_", " "), shown(value)])
    return rows


def row_figures(
    name: str, rows: list[Row], columns: int = COLUMNS, below: float = 0.34
) -> dict[str, Figure]:
    """A figure for each row, ``name-01`` and so on, so that a page may end between two of them."""
    return numbered(name, [draw_rows([row], columns, below) for row in rows])


def numbered(name: str, figures: Sequence[Figure]) -> dict[str, Figure]:
    """Figures by the names under which a template finds them in order."""
    return {f"{name}-{index:02d}": figure for index, figure in enumerate(figures, start=1)}
