"""A page per problem: picture, equations, parameters, best known values, verdicts per law."""

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


def pages() -> dict[str, str]:
    """The page of each problem, and one that shows them all."""
    shown = [read(kind) for kind in ("verdicts", "refined") if (DATA / f"{kind}.json").exists()]
    written = {f"gallery/{name}.md": page(spec(name), shown) for name in names()}
    return {"gallery/index.md": index(), **written}


def index() -> str:
    """All problems as cards, each with its picture."""
    cards = "".join(map(_card, map(spec, names())))
    return (
        "# Gallery\n\nThe problems of the workbench. Each is one command, `ocp solve NAME`, at any"
        " parameters, under any law, by any method.\n\n"
        f'<div class="grid cards" markdown>\n\n{cards}\n</div>\n'
    )


def _card(found: ProblemSpec) -> str:
    picture = f"    ![]({still})\n\n" if (still := _still(found.name)) else ""
    return f"-   [**{found.name}**]({found.name}.md)\n\n{picture}    {found.title}\n\n"


def _still(name: str) -> str:
    file = PICTURES / "problems" / f"{name}.png"
    return f"../../pictures/problems/{name}.png" if file.exists() else ""


def page(found: ProblemSpec, shown: Sequence[Mapping[str, Any]]) -> str:
    """One problem from its spec, and its rows of measured tables."""
    solve = f"```sh\nocp solve {found.name} --contact exact\n```\n"
    parts = [f"# {found.name}\n", f"{found.title}.\n", *_pictures(found), solve]
    if found.equations:
        used = cleaned(found.build.__doc__)
        parts.append(f"## Equations\n\n{listed(found.name)}\nIn the code, `build`: {used}\n")
    parts.append(f"## Parameters\n\n{_parameters(found)}")
    if found.golden:
        parts.append(f"## Best known values\n\n{_golden(found)}")
    parts += [_measured(found.name, one) for one in shown if _rows(found.name, one)]
    if found.citation is not None:
        source = full_citation(found.citation.key)
        parts.append(f"## Source\n\n{found.citation.text} ({source}).\n")
    return "\n".join(parts)


def _pictures(found: ProblemSpec) -> list[str]:
    moving = PICTURES / f"{found.name}.gif"
    shown = []
    if moving.exists():
        shown.append(f"![{found.title}, in motion](../../pictures/{found.name}.gif)\n")
    if still := _still(found.name):
        shown.append(f"![{found.title}: early instants faint, contact forces in orange]({still})\n")
    return shown


def _parameters(found: ProblemSpec) -> str:
    rows = [
        (f"`{row['name']}`", row["value"], powers(row["unit"]), _range(row), row["description"])
        for row in describe(found)
    ]
    return table(("parameter", "default", "unit", "range", "meaning"), rows)


def _range(row: Mapping[str, Any]) -> str:
    limits = row["range"].removesuffix(f" [{row['unit']}]")
    return re.sub("^a number ?", "", limits)


def _golden(found: ProblemSpec) -> str:
    rows = [
        (key, best.law, best.method, f"{best.cost:.9g}", best.certificate, best.tried)
        for key, best in found.golden.items()
    ]
    columns = ("best known", "law", "method", "cost", "certificate", "of solves")
    remarks = [f"- {key}: {best.remarks}\n" for key, best in found.golden.items() if best.remarks]
    return table(columns, rows) + ("\n" + "".join(remarks) if remarks else "")


def _rows(name: str, measured: Mapping[str, Any]) -> list[list[Any]]:
    return [row[1:] for row in measured["rows"] if row[0] == name]


def _measured(name: str, measured: Mapping[str, Any]) -> str:
    shown = {**measured, "columns": measured["columns"][1:], "rows": _rows(name, measured)}
    return f"## {measured['title']}\n\n{snippet(shown)}"
