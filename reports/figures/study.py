"""The page of a study: its figure, its claims, its parameters, where they come from."""

from __future__ import annotations

from typing import Any

from matplotlib.figure import Figure

from ocp.store.stored_run import StoredRun
from problems.parameters import unit_of
from problems.studies import get
from problems.studies.study import CHOICE
from reports.bibliography import full_citation
from reports.console import number
from reports.figures.run import powers
from reports.figures.studies import DRAWINGS


def study_page(run: StoredRun) -> tuple[dict[str, Any], dict[str, Figure]]:
    """Content and figure of a stored study; raises ``InputError`` for an unknown one."""
    meta = run.meta
    study = get(meta["problem"])
    drawing = DRAWINGS[study.id]
    content = {
        "title": f"{study.id}: {study.title}",
        "hash": meta["hash"],
        "verdict": meta["verdict"],
        "caption": drawing.caption,
        "claims": meta["claims"],
        "notes": list(study.notes),
        "parameters": [
            [name, _shown(run.record["params"][name]), _unit(about), about.description or "",
             _origin(about)]
            for name, about in study.Params.model_fields.items()
            if name in run.record["params"]
        ],
        "citation": f"{study.citation.text}. {full_citation(study.citation.key)}.",
        "versions": [[name, version] for name, version in meta.get("versions", {}).items()],
    }  # fmt: skip
    return content, {"study": drawing.draw(run.data)}


def _shown(value: Any) -> str:
    return number(value) if isinstance(value, int | float) else str(value)


def _unit(about: Any) -> str:
    unit = unit_of(about)
    return "" if unit == "1" else powers(unit)


def _origin(about: Any) -> str:
    return str(about.json_schema_extra.get("origin", CHOICE))
