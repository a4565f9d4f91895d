"""A page per figure: its picture, and every claim of the papers with the measured value.

Claims lie as JSON in ``docs/generated/data/claims``; ``make claims`` measures them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from problems import studies
from problems.studies import FigureStudy
from problems.studies.study import counted, verdict
from reports.figures.studies import DRAWINGS
from reports.notation import full_citation
from reports.site.measured import DATA, DOCS, escaped, provenance, read, table

COLUMNS = ("claim", "source", "expected", "measured", "holds")
PAPERS = {
    "N": "How noising data affects learned contact dynamics",
    "P": "Pathologies of differentiable simulation through contact",
    "A": "Adaptive barrier smoothing",
    "T": "Theorems of all three",
}
"""What figures reproduce, by the first letter of their names."""


def measured() -> dict[str, dict[str, Any]]:
    """Claims of every figure that was made, by its name, in the order of the papers."""
    made = {file.stem for file in (DATA / "claims").glob("*.json")}
    return {name: read(f"claims/{name}") for name in studies.ids() if name in made}


def pages() -> dict[str, str]:
    """The page of each figure, and one that lists them."""
    found = measured()
    written = {f"figures/{name}.md": page(studies.get(name), found[name]) for name in found}
    return {"figures/index.md": index(found), **written}


def index(found: Mapping[str, Mapping[str, Any]]) -> str:
    """List the figures, paper by paper, with how many of their claims hold."""
    every = [claim for figure in found.values() for claim in figure["claims"]]
    parts = [
        "# Figures\n",
        f"{counted(every)} claims hold; those that do not are listed too.\n",
        "Each figure of the papers is one command, which computes its data, draws it, and checks"
        " the claims of the paper: `ocp figure P3` writes a PDF beside its data.\n",
    ]
    for letter, paper in PAPERS.items():
        rows = [
            (f"[{name}]({name}.md)", studies.get(name).title, counted(figure["claims"]))
            for name, figure in found.items()
            if name.startswith(letter)
        ]
        if rows:
            parts += [f"## {paper}\n", table(("", "what it shows", "claims that hold"), rows)]
    return "\n".join(parts)


def page(study: FigureStudy, figure: Mapping[str, Any]) -> str:
    """One figure: picture, caption, source, notes, claims, and where the numbers come from."""
    source = f"Source: {study.citation.text} of {full_citation(study.citation.key)}"
    source += "" if source.endswith(("?", "!", ".")) else "."
    parts = [f"# {study.id}: {study.title}\n"]
    if (DOCS / "pictures" / "figures" / f"{study.id}.png").exists():
        parts.append(f"![{study.title}](../../pictures/figures/{study.id}.png)\n")
    parts += [f"{DRAWINGS[study.id].caption}\n", f"{source}\n"]
    parts += [
        f"## Claims\n\n{counted(figure['claims'])} hold.\n",
        claims(figure),
        provenance(figure),
    ]
    if study.notes:
        parts.append("## Notes\n\n" + "".join(f"- {note}\n" for note in study.notes))
    return "\n".join(parts)


def claims(figure: Mapping[str, Any]) -> str:
    """A figure's claims as a table, with a bold mark on those that do not hold."""
    marks, rows = {"holds": "yes", "does not hold": "**no**"}, []
    for claim in figure["claims"]:
        word = verdict(claim["holds"], claim.get("margin"))
        rows.append([*(escaped(claim[name]) for name in COLUMNS[:-1]), marks.get(word, word)])
    return table(COLUMNS, rows)
