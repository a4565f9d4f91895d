"""Notebooks of ``examples`` as pages, with the outputs that ``make notebooks`` stores in them."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from docs.generator.measured import DOCS

FOLDER = DOCS.parent / "examples"
"""Folder of the notebooks."""
_PANDAS = re.compile(r'<style scoped>.*?</style>|(?<=<table) border="1" class="dataframe"', re.S)
"""Pattern of the styles of pandas tables, which are removed."""
_MARKER = re.compile(r"<!-- notebook: ([\w-]+) -->")
"""Pattern of the marker of the notebook that a page shows."""


def shown(page: str) -> str:
    """Return the page, or, if it has ``<!-- notebook: NAME -->``, the texts, code and outputs of that notebook."""
    marker = _MARKER.search(page)
    cells = _cells(FOLDER / f"{marker[1]}.ipynb") if marker else []
    return "\n\n".join(block for cell in cells for block in _parts(cell)) or page


def title(path: Path) -> str:
    """Return the heading with which the notebook at ``path`` begins."""
    return _cells(path)[0]["source"][0].strip("# \n")


def _cells(path: Path) -> list[dict[str, Any]]:
    return json.loads(path.read_text(encoding="utf-8"))["cells"]


def _parts(cell: dict[str, Any]) -> list[str]:
    text = "".join(cell["source"])
    if cell["cell_type"] != "code":
        return [text]
    return [f"```python\n{text}\n```", *map(_output, cell["outputs"])]


def _output(output: dict[str, Any]) -> str:
    """Return the richest form of a cell's output that a page can show: picture, HTML, or text."""
    data = {kind: "".join(text) for kind, text in output.get("data", {}).items()}
    if picture := data.get("image/png"):
        source = f"data:image/png;base64,{picture.strip()}"
        return f'<p><img alt="What the cell above draws" src="{source}"></p>'
    if page := data.get("text/html"):
        return _PANDAS.sub("", page).replace("\n", "")
    return "```text\n" + data.get("text/plain", "".join(output.get("text", ()))).strip() + "\n```"
