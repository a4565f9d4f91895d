"""Write the tables of claims into the README from what ``ocp figure --all --json`` printed.

``python -m reports.claims FIGURES.json README.md`` rewrites what is between the two markers, and
between those of the table :mod:`reports.smoothings` where N3 is among the figures;
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

from ocp.errors import InputError
from reports import smoothings

BEGIN, END = "<!-- made by make claims -->", "<!-- end of make claims -->"
COLUMNS = ("claim", "source", "expected", "measured", "holds")


def block(figures: Sequence[Mapping[str, Any]]) -> str:
    """Markdown of all figures: how many claims hold, and one table a figure that opens."""
    every = [claim for figure in figures for claim in figure["claims"]]
    good = sum(claim["holds"] for claim in every)
    head = f"Of {len(every)} claims {good} hold; those that do not are in the list on purpose.\n"
    return "\n".join([head, *(_details(figure) for figure in figures)])


def _details(figure: Mapping[str, Any]) -> str:
    claims = figure["claims"]
    good = sum(claim["holds"] for claim in claims)
    rows = [COLUMNS, ["---"] * len(COLUMNS), *(_row(claim) for claim in claims)]
    table = "\n".join(f"| {' | '.join(cells)} |" for cells in rows)
    summary = f"{figure['id']}: {good} of {len(claims)} hold"
    return f"<details><summary>{summary}</summary>\n\n{table}\n\n</details>\n"


def _row(claim: Mapping[str, Any]) -> list[str]:
    """Cells of one claim; a bar within a cell would end it."""
    texts = [str(claim[name]).replace("|", "\\|") for name in COLUMNS[:-1]]
    return [*texts, "yes" if claim["holds"] else "no"]


def rewritten(text: str, figures: Sequence[Mapping[str, Any]]) -> str:
    """Put the block of ``figures`` between the markers of ``text``, as :func:`replaced` does."""
    return replaced(text, block(figures), BEGIN, END)


def replaced(text: str, block: str, begin: str, end: str) -> str:
    """Put ``block`` between the markers ``begin`` and ``end`` of ``text``.

    Raises :class:`~ocp.errors.InputError` where they are not there once each, in this order.
    """
    before, found, rest = text.partition(begin)
    _, last, after = rest.partition(end)
    if not found or not last or begin in rest or end in after:
        raise InputError(f"expected {begin} and then {end}, once each")
    return f"{before}{begin}\n{block}{end}{after}"


def with_table(text: str, figures: Sequence[Mapping[str, Any]]) -> str:
    """Put the table of N3 between its markers; ``text`` as it is where N3 is not in ``figures``."""
    for figure in figures:
        if figure["id"] == "N3":
            file = next(name for name in figure["files"] if name.endswith(".nc"))
            with xr.open_dataset(file, engine="scipy") as data:
                block = smoothings.table(data)
            return replaced(text, block, smoothings.BEGIN, smoothings.END)
    return text


def main() -> None:
    """Rewrite the file that the command line names."""
    parser = ArgumentParser(prog="python -m reports.claims", description=__doc__)
    parser.add_argument("figures", type=Path, metavar="FIGURES.json")
    parser.add_argument("page", type=Path, metavar="README.md")
    asked = parser.parse_args()
    figures = json.loads(asked.figures.read_text())["figures"]
    try:
        page = with_table(rewritten(asked.page.read_text(), figures), figures)
        asked.page.write_text(page)
    except InputError as error:
        sys.exit(f"error: {asked.page}: {error}")


if __name__ == "__main__":
    main()
