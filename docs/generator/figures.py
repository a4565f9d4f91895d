"""A page per figure: its picture, and every claim of the papers with the measured value.

Claims are stored as JSON in ``docs/generated/data/claims``. ``python -m docs.generator.figures
FILE.json`` stores the claims of that file, the output of ``ocp figure --all --json``, each picture as
``docs/pictures/figures/<id>.png``, and for N3 and C1 the tables of :mod:`docs.generator.law_tables`;
``make claims`` makes the figures first.
"""

from __future__ import annotations

import json
import sys
from argparse import ArgumentParser
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import xarray as xr

from docs.generator import law_tables
from docs.generator.measured import (
    DATA,
    DOCS,
    escaped,
    origin,
    provenance,
    read,
    save_picture,
    table,
    write_data,
    write_table,
)
from ocp.errors import InputError
from problems import studies
from problems.studies import FigureStudy
from problems.studies.study import claim_verdict, count_text
from reports.documents.citations import full_citation
from reports.drawing.style import house_style
from reports.figures.studies import DRAWINGS

COLUMNS = ("claim", "source", "expected", "measured", "holds")
"""Columns of the table of claims."""
PAPERS = {
    "N": "How noising data affects learned contact dynamics",
    "P": "Pathologies of differentiable simulation through contact",
    "A": "Adaptive barrier smoothing",
    "C": "Linear feedback on smoothed dynamics, and planning again",
    "T": "Theorems of all three",
}
"""Mapping from the first letter of a figure's name to the paper or subject that it reproduces."""

_TABLES = {"N3": ("smoothings", law_tables.smoothing_rows), "C1": ("smoothings-in-the-loop", law_tables.loop_rows)}
"""Mapping from a figure to the name of its table, and to the function that returns the table's rows."""


def measured() -> dict[str, dict[str, Any]]:
    """Return a mapping from the name of each stored figure to its claims, in the order of the papers."""
    stored_names = {file.stem for file in (DATA / "claims").glob("*.json")}
    return {name: read(f"claims/{name}") for name in studies.ids() if name in stored_names}


def pages() -> dict[str, str]:
    """Return the page of each figure, and a page that lists them, as a mapping from path to text."""
    figures_by_name = measured()
    figure_pages = {f"figures/{name}.md": page(studies.get(name), figures_by_name[name]) for name in figures_by_name}
    return {"figures/index.md": index(figures_by_name), **figure_pages}


def index(figures_by_name: Mapping[str, Mapping[str, Any]]) -> str:
    """Return the page that lists the figures of each paper, with the number of claims that hold."""
    all_claims = [claim for figure in figures_by_name.values() for claim in figure["claims"]]
    sections = [
        "# Figures\n",
        f"{count_text(all_claims)} claims hold; those that do not are listed too.\n",
        "Each figure of the papers is one command, which computes its data, draws it, and checks"
        " the claims of the paper: `ocp figure P3` writes a PDF beside its data.\n",
    ]
    for letter, paper in PAPERS.items():
        rows = [
            (f"[{name}]({name}.md)", studies.get(name).title, count_text(figure["claims"]))
            for name, figure in figures_by_name.items()
            if name.startswith(letter)
        ]
        if rows:
            sections += [f"## {paper}\n", table(("", "what it shows", "claims that hold"), rows)]
    return "\n".join(sections)


def page(study: FigureStudy, figure: Mapping[str, Any]) -> str:
    """Return the page of a figure: picture, caption, source, claims with their origin, and notes."""
    source = f"Source: {study.citation.text} of {full_citation(study.citation.key)}"
    source += "" if source.endswith(("?", "!", ".")) else "."
    sections = [f"# {study.id}: {study.title}\n"]
    if (DOCS / "pictures" / "figures" / f"{study.id}.png").exists():
        sections.append(f"![{study.title}](../../pictures/figures/{study.id}.png)\n")
    sections += [f"{DRAWINGS[study.id].caption}\n", f"{source}\n"]
    sections += [f"## Claims\n\n{count_text(figure['claims'])} hold.\n", claims(figure), provenance(figure)]
    if study.notes:
        sections.append("## Notes\n\n" + "".join(f"- {note}\n" for note in study.notes))
    return "\n".join(sections)


def claims(figure: Mapping[str, Any]) -> str:
    """Return the claims of a figure as a table, with a bold mark on those that do not hold."""
    marks, rows = {"holds": "yes", "does not hold": "**no**"}, []
    for claim in figure["claims"]:
        word = claim_verdict(claim["holds"], claim.get("margin"))
        rows.append([*(escaped(claim[name]) for name in COLUMNS[:-1]), marks.get(word, word)])
    return table(COLUMNS, rows)


def stored(figure: Mapping[str, Any]) -> dict[str, Any]:
    """Return the claims of a figure and their origin, as stored for the site."""
    keys = (*COLUMNS, "margin")
    claims = [{name: claim[name] for name in keys if claim.get(name) is not None} for claim in figure["claims"]]
    command = f"ocp figure {figure['id']}"
    return {"id": figure["id"], **origin(command), "claims": claims}


def keep(figures: Sequence[Mapping[str, Any]]) -> list[Path]:
    """Write the claims, pictures and tables of ``figures``; return the files.

    Raises :class:`~ocp.errors.InputError` for a figure without a study.
    """
    written_files = []
    for figure in figures:
        study = studies.get(figure["id"])
        written_files.append(write_data(f"claims/{study.id}", stored(figure)))
        for file in (name for name in figure.get("files", ()) if name.endswith(".nc")):
            with xr.open_dataset(file, engine="scipy") as data, house_style():
                drawing = DRAWINGS[study.id].draw(data)
                written_files.append(save_picture(drawing, f"figures/{study.id}"))
                if study.id in _TABLES:
                    name, rows_of = _TABLES[study.id]
                    columns, *rows = rows_of(data)
                    written_files.append(
                        write_table(
                            name, title=study.title, command=f"ocp figure {study.id}", columns=columns, rows=rows
                        )
                    )
    return written_files


def main() -> None:
    """Store the figures in the file that the command line names."""
    parser = ArgumentParser(prog="python -m docs.generator.figures", description=__doc__)
    parser.add_argument("figures", type=Path, metavar="FIGURES.json")
    arguments = parser.parse_args()
    content = json.loads(arguments.figures.read_text())
    try:
        keep(content.get("figures", [content]))
    except InputError as error:
        sys.exit(f"error: {arguments.figures}: {error}")


if __name__ == "__main__":
    main()
