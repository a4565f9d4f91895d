"""A page an example: what it shows, and its source."""

from __future__ import annotations

import ast

from reports.site.markdown import table
from reports.site.measured import DOCS

FOLDER = DOCS.parent / "examples"


def pages() -> dict[str, str]:
    """The page of each script of ``examples``, and a list of them and of the notebooks."""
    scripts = {file.stem: file.read_text(encoding="utf-8") for file in sorted(FOLDER.glob("*.py"))}
    rows = [(f"[{name}]({name}.md)", said(source)) for name, source in scripts.items()]
    rows += [(f"`{book.name}`", "a notebook") for book in sorted(FOLDER.glob("*.ipynb"))]
    written = {
        f"examples/{name}.md": f'# {name}\n\n```python title="examples/{name}.py"\n{source}```\n'
        for name, source in scripts.items()
    }
    head = "# Examples\n\nWhole files that run, in `examples/` of the checkout.\n\n"
    return {"examples/index.md": head + table(("", "what it shows"), rows), **written}


def said(source: str) -> str:
    """The first sentence of a script's docstring."""
    return (ast.get_docstring(ast.parse(source)) or "").partition("\n\n")[0].replace("\n", " ")
