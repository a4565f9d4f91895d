"""``ocp report RUN... -o FILE.pdf``: a PDF from stored runs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from reports.cli.common import Debug, Json, Out, Output, Quiet


def run(
    runs: Annotated[list[str], typer.Argument(help="Runs: paths, or parts of their names.")],
    pdf: Annotated[Path, typer.Option("--output", "-o", help="The PDF to write.")],
    out: Out = Path("runs"),
    as_json: Json = False,
    quiet: Quiet = False,
    debug: Debug = False,
) -> int:
    """Write a PDF of one stored run, or of several side by side."""
    from ocp import store
    from reports.cli.request import check_pdf_place
    from reports.cli.runs_command import find
    from reports.pdf import write_pdf

    check_pdf_place(pdf)
    stored = [store.load(find(text, out)) for text in runs]
    write_pdf(stored, pdf)
    output = Output(as_json, quiet)
    output.say(f"PDF: {pdf}")
    output.document({"pdf": str(pdf), "runs": [str(item.path) for item in stored]})
    return 0
