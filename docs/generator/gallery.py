"""A page per problem: pictures, equations, parameters, best known values, and verdicts for each law."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from docs.generator.equations import listed
from docs.generator.measured import DATA, DOCS, read, snippet, table
from docs.generator.roles import cleaned
from problems import describe, names, spec
from problems.spec import ProblemSpec
from reports.documents.citations import full_citation
from reports.drawing.notation import powers

PICTURES = DOCS / "pictures"
"""Folder of the site's pictures."""


def pages() -> dict[str, str]:
    """Return the page of each problem, and a page that shows them all, as a mapping from path to text."""
    measured_tables = [read(kind) for kind in ("verdicts", "refined", "survives") if (DATA / f"{kind}.json").exists()]
    problem_pages = {f"gallery/{name}.md": page(spec(name), measured_tables) for name in names()}
    return {"gallery/index.md": index(), **problem_pages}


def index() -> str:
    """Return the page that shows all problems as cards with pictures."""
    cards = "".join(map(_card, map(spec, names())))
    return (
        "# Gallery\n\nThe problems of the workbench. Each is one command, `ocp solve NAME`, at any"
        " parameters, under any law, by any method.\n\n"
        f'<div class="grid cards" markdown>\n\n{cards}\n</div>\n'
    )


def _card(problem_spec: ProblemSpec) -> str:
    picture = f"    ![]({still})\n\n" if (still := _still(problem_spec.name)) else ""
    return f"-   [**{problem_spec.name}**]({problem_spec.name}.md)\n\n{picture}    {problem_spec.title}\n\n"


def _still(name: str) -> str:
    file = PICTURES / "problems" / f"{name}.png"
    return f"../../pictures/problems/{name}.png" if file.exists() else ""


def page(problem_spec: ProblemSpec, measured_tables: Sequence[Mapping[str, Any]]) -> str:
    """Return the page of a problem, with its rows of the measured tables."""
    solve = f"```sh\nocp solve {problem_spec.name} --contact exact\n```\n"
    sections = [f"# {problem_spec.name}\n", f"{problem_spec.title}.\n", *_pictures(problem_spec), solve]
    if problem_spec.equations:
        used = cleaned(problem_spec.build.__doc__)
        sections.append(f"## Equations\n\n{listed(problem_spec.name)}\nIn the code, `build`: {used}\n")
    sections.append(f"## Parameters\n\n{_parameters(problem_spec)}")
    if problem_spec.golden:
        sections.append(f"## Best known values\n\n{_golden(problem_spec)}")
    sections += [
        _measured(problem_spec.name, measured_table)
        for measured_table in measured_tables
        if _rows(problem_spec.name, measured_table)
    ]
    if problem_spec.citation is not None:
        source = full_citation(problem_spec.citation.key)
        sections.append(f"## Source\n\n{problem_spec.citation.text} ({source}).\n")
    return "\n".join(sections)


def _pictures(problem_spec: ProblemSpec) -> list[str]:
    moving = PICTURES / f"{problem_spec.name}.gif"
    image_lines = []
    if moving.exists():
        image_lines.append(f"![{problem_spec.title}, in motion](../../pictures/{problem_spec.name}.gif)\n")
    if still := _still(problem_spec.name):
        image_lines.append(f"![{problem_spec.title}: early instants faint, contact forces in orange]({still})\n")
    return image_lines


def _parameters(problem_spec: ProblemSpec) -> str:
    rows = [
        (f"`{row['name']}`", row["value"], powers(row["unit"]), _range(row), row["description"])
        for row in describe(problem_spec)
    ]
    return table(("parameter", "default", "unit", "range", "meaning"), rows)


def _range(row: Mapping[str, Any]) -> str:
    limits = row["range"].removesuffix(f" [{row['unit']}]")
    return re.sub("^a number ?", "", limits)


def _golden(problem_spec: ProblemSpec) -> str:
    rows = [
        (key, golden.law, golden.method, f"{golden.cost:.9g}", golden.certificate, golden.tried)
        for key, golden in problem_spec.golden.items()
    ]
    columns = ("best known", "law", "method", "cost", "certificate", "of solves")
    remarks = [f"- {key}: {golden.remarks}\n" for key, golden in problem_spec.golden.items() if golden.remarks]
    return table(columns, rows) + ("\n" + "".join(remarks) if remarks else "")


def _rows(name: str, measured: Mapping[str, Any]) -> list[list[Any]]:
    return [row[1:] for row in measured["rows"] if row[0] == name]


def _measured(name: str, measured: Mapping[str, Any]) -> str:
    problem_table = {**measured, "columns": measured["columns"][1:], "rows": _rows(name, measured)}
    return f"## {measured['title']}\n\n{snippet(problem_table)}"
