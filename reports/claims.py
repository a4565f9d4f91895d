"""Write the tables of claims into the README from what ``ocp figure --all --json`` printed.

``python -m reports.claims FIGURES.json README.md`` rewrites what is between the two markers;
``make claims`` makes the figures first.
"""

from __future__ import annotations

import json
import sys
from argparse import ArgumentParser
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ocp.errors import InputError

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
    """Put the block of ``figures`` between the markers of ``text``.

    Raises :class:`~ocp.errors.InputError` where they are not there once each, in this order.
    """
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end or BEGIN in rest or END in after:
        raise InputError(f"expected {BEGIN} and then {END}, once each")
    return f"{before}{BEGIN}\n{block(figures)}{END}{after}"


def main() -> None:
    """Rewrite the file that the command line names."""
    parser = ArgumentParser(prog="python -m reports.claims", description=__doc__)
    parser.add_argument("figures", type=Path, metavar="FIGURES.json")
    parser.add_argument("page", type=Path, metavar="README.md")
    asked = parser.parse_args()
    figures = json.loads(asked.figures.read_text())["figures"]
    try:
        asked.page.write_text(rewritten(asked.page.read_text(), figures))
    except InputError as error:
        sys.exit(f"error: {asked.page}: {error}")


if __name__ == "__main__":
    main()
