"""Store the output of ``ocp figure --all --json`` for the site.

``python -m reports.site.claims FIGURES.json`` writes the claims of every figure in it to
``docs/generated/data/claims/<id>.json``, its picture to ``docs/pictures/figures/<id>.png``, and of
N3 the table :mod:`reports.smoothings`; ``make claims`` makes the figures first.
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
from problems import studies
from reports import smoothings
from reports.figures.studies import DRAWINGS
from reports.site import measured
from reports.site.figures import COLUMNS
from reports.style import styled


def stored(figure: Mapping[str, Any]) -> dict[str, Any]:
    """The claims of a figure for the site, and their origin."""
    keys = (*COLUMNS, "margin")
    claims = [
        {name: claim[name] for name in keys if claim.get(name) is not None}
        for claim in figure["claims"]
    ]
    command = f"ocp figure {figure['id']}"
    return {"id": figure["id"], **measured.origin(command), "claims": claims}


def keep(figures: Sequence[Mapping[str, Any]]) -> list[Path]:
    """Write claims, pictures and the table of smoothings; returns the files.

    Raises :class:`~ocp.errors.InputError` for a figure that no study has.
    """
    written = []
    for figure in figures:
        study = studies.get(figure["id"])
        written.append(measured.write_data(f"claims/{study.id}", stored(figure)))
        for file in (name for name in figure.get("files", ()) if name.endswith(".nc")):
            with xr.open_dataset(file, engine="scipy") as data, styled():
                drawn = DRAWINGS[study.id].draw(data)
                written.append(measured.save_picture(drawn, f"figures/{study.id}"))
                if study.id == "N3":
                    columns, *rows = smoothings.rows(data)
                    written.append(measured.write_table(
                        "smoothings", title="Which smoothing to trust", command="ocp figure N3",
                        columns=columns, rows=rows,
                    ))  # fmt: skip
    return written


def main() -> None:
    """Store the content of the file on the command line."""
    parser = ArgumentParser(prog="python -m reports.site.claims", description=__doc__)
    parser.add_argument("figures", type=Path, metavar="FIGURES.json")
    given = parser.parse_args()
    content = json.loads(given.figures.read_text())
    try:
        keep(content.get("figures", [content]))
    except InputError as error:
        sys.exit(f"error: {given.figures}: {error}")


if __name__ == "__main__":
    main()
