"""Content shared by all pages: the request of a run, its equations, parameters and settings."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from dynamics.laws import LAWS
from dynamics.settings import settings_of
from ocp.store.stored_run import StoredRun
from problems.spec import Spec
from reports.documents.citations import full_citation
from reports.drawing.notation import in_symbols, plain, powers, symbol
from reports.drawing.view import RunView
from reports.figures.panels import PANEL_COLUMNS, Row, draw_rows
from reports.tables.console import number

if TYPE_CHECKING:
    from problems.studies.study import FigureStudy

Page = tuple[dict[str, Any], dict[str, Figure]]
_NOT_SETTINGS = (
    "params",
    "problem",
    "source",
    "versions",
    "citation",
    "audit_s",
    "N",
    "law_parameters",
    "sweep",
    "jit",
    "learned_at",
    "sensitivities",
    "unbounded",
    "search",
    "ladder",
    "most_exact",
)
"""Keys of a run's record that are not in the table of settings."""
_REQUEST_KEYS = ("contact", "method", "policy", "solver")
"""Keys of a run's record that :func:`request_rows` shows."""
_LEAST_MU = 1e-12
"""Smallest mu [N s m] that is written as a number."""
_UNLOADED = (
    "The file of this problem was not loaded; the page shows what the run stores of it. ocp report"
    " --source FILE adds the equations and drawings from the file."
)
"""Note on the page of a run whose problem file was not loaded."""


def page_header(view: RunView) -> dict[str, Any]:
    """Return the title and the content of :func:`run_summary`."""
    values = view.run.record.get("params", {}) if view.spec is None else view.params.model_dump()
    return {"title": view.title, **run_summary(view.run, view.spec, values)}


def run_summary(run: StoredRun, spec: Spec | FigureStudy | None, values: dict[str, Any]) -> dict[str, Any]:
    """Return hash, verdict, request, equations, parameters, citation, settings and versions of a run."""
    cited = spec.citation if spec else None
    stored = run.own_problem if spec is None else None
    return {
        "hash": run.meta["hash"],
        "verdict": run.meta["verdict"],
        "request": request_rows(run),
        "equations": list(spec.equations) if isinstance(spec, Spec) else [],
        # Equations stored in a run stay plain text: as typst's mathematics they would be code that a page executes.
        "typed": [plain(line) for line in stored["equations"]] if stored else [],
        "unloaded": _UNLOADED if stored else "",
        "parameters": _parameters(spec, stored, values),
        "citation": _as_sentence(f"{cited.text}. {full_citation(cited.key)}") if cited else "",
        "settings": setting_rows(run),
        "versions": text_rows(run.meta.get("versions") or {}),
    }


def _as_sentence(text: str) -> str:
    """Return a text with a full stop added, unless it already ends like a sentence."""
    return text if text.endswith((".", "?", "!")) else f"{text}."


def request_rows(run: StoredRun, without: Collection[str] = ()) -> list[list[str]]:
    """Return rows on the law with its settings except ``without``, the method, policy and solver."""
    record = run.record
    request_lines = [["law", law_text(run, without)]] if record.get("contact") else []
    request_lines += [[key, str(record[key])] for key in _REQUEST_KEYS[1:] if record.get(key)]
    if record.get("N"):
        request_lines.append(["steps", str(record["N"])])
    scenarios = run.data.sizes.get("scenario", 1)
    return request_lines + ([["scenarios", str(scenarios)]] if scenarios > 1 else [])


def law_text(run: StoredRun, without: Collection[str] = ()) -> str:
    """Return name and settings of the law, such as ``barrier (μ = 0.001)``, except settings in ``without``."""
    name = str(run.record["contact"])
    law_settings = {key: value for key, value in _law_settings(run, name).items() if f"contact.{key}" not in without}
    settings = ", ".join(f"{symbol(key)} = {as_text(value)}" for key, value in law_settings.items())
    return f"{name} ({settings})" if settings else name


def _law_settings(run: StoredRun, name: str) -> dict[str, Any]:
    """Return the settings of a run's law; for an estimate, as typed by the user, without defaults."""
    typed = run.record.get("law_settings")
    if typed:
        return dict(text.partition("=")[::2] for text in typed)
    law_class = LAWS.get(name)
    if typed is not None and law_class is not None:
        return law_class().settings()
    return run.record.get("contact_settings") or {}


def law_summary(view: RunView) -> dict[str, Any]:
    """Return name and summary of the law, and a sentence on the values of mu along the plan."""
    name = str(view.run.record.get("contact", ""))
    law_class = LAWS.get(name)
    return {
        "name": name,
        "summary": in_symbols(law_class.summary) if law_class else "",
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


def _parameters(
    spec: Spec | FigureStudy | None, stored: dict[str, Any] | None, values: dict[str, Any]
) -> list[list[str]]:
    """Return name, value, unit and meaning of every parameter, from the problem or from the run."""
    about = dict.fromkeys(values, ("", ""))
    if spec is not None:
        about = {name: (setting.unit, setting.meaning) for name, setting in settings_of(spec.Params).items()}
    elif stored:
        stored_parameters = stored["parameters"].items()
        about |= {name: (field["unit"], field["description"]) for name, field in stored_parameters}
    return [
        [name, as_text(values[name]), powers(unit), meaning]
        for name, (unit, meaning) in about.items()
        if name in values
    ]


def as_text(value: Any) -> str:
    """Return a value as text: numbers with 8 digits, lists with commas, booleans as yes or no."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, list | tuple):
        return ", ".join(as_text(entry) for entry in value)
    return number(value, 8) if isinstance(value, int | float) else str(value)


def setting_rows(run: StoredRun) -> list[list[str]]:
    """Return rows on the settings of the request that are not in another table or line."""
    remaining = {key: value for key, value in run.record.items() if key not in _NOT_SETTINGS}
    return [row for row in text_rows(remaining) if row[0] not in _REQUEST_KEYS and not row[0].startswith("contact.")]


def text_rows(values: dict[str, Any]) -> list[list[str]]:
    """Return rows of name and value as text; values in nested dictionaries are named ``group.name``."""
    rows = []
    for key, value in values.items():
        if isinstance(value, dict):
            group = key.removesuffix("_settings").removesuffix("_options")
            rows += [[f"{group}.{name}", text] for name, text in text_rows(value)]
        elif value is not None and value != []:
            rows.append([key.replace("_", " "), as_text(value)])
    return rows


def row_figures(name: str, rows: list[Row], columns: int = PANEL_COLUMNS, below: float = 0.34) -> dict[str, Figure]:
    """Return a mapping from ``name-01`` and so on to a figure of each row, so that pages can break between rows."""
    return numbered_figures(name, [draw_rows([row], columns, below) for row in rows])


def numbered_figures(name: str, figures: Sequence[Figure]) -> dict[str, Figure]:
    """Return a mapping from ``name-01``, ``name-02`` and so on to the figures; templates place them in this order."""
    return {f"{name}-{index:02d}": figure for index, figure in enumerate(figures, start=1)}
