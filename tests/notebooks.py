"""``make notebooks``: execute the notebooks in ``examples`` and store the outputs of their cells."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import nbclient
import nbformat

from docs.generator.notebooks import FOLDER


def execute(path: Path) -> Any:
    """Return the executed notebook, without metadata of the run."""
    notebook = nbformat.read(path, 4)
    about = {"metadata": {"path": str(FOLDER)}}
    nbclient.NotebookClient(notebook, timeout=600, kernel_name="python3", resources=about).execute()
    for cell in notebook.cells:
        cell.metadata = {}
    notebook.metadata["language_info"] = {"name": "python"}
    return notebook


if __name__ == "__main__":
    for file in sorted(FOLDER.glob("*.ipynb")):
        nbformat.write(execute(file), file)
