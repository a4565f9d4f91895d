"""A report does not end with an almost empty page."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
import typst

from reports.documents import pdf

PAGE = """#import "common.typ": *
#show: page-style.with("title", "hash", ())
#for k in range({count}) [#block(above: 0pt, below: 0pt, height: 1.8 * scale)]
"""


def set_page(root: Path, count: int) -> dict[str, Any]:
    """Set a document of ``count`` figures, each 18 % of a page high; return the position of its end, and its scale."""
    for file in pdf._TEMPLATES.glob("*.typ"):
        shutil.copy(file, root)
    blocks = PAGE.format(count=count).replace("1.8 * scale", "scale() / 100% * 130pt")
    (root / "t.typ").write_text(blocks)
    assert pdf._with_full_pages(root, "t.typ", {}).startswith(b"%PDF")
    options = {"root": str(root), "ignore_system_fonts": True}
    end = json.loads(typst.query(str(root / "t.typ"), "<end>", field="value", one=True, **options))
    return {**end, "scale": json.loads((root / "content.json").read_text())["scale"]}


@pytest.mark.parametrize(
    ("count", "page", "scale"),
    [(3, 1, 1.0), (5, 1, 1.0), (6, 1, 0.88), (9, 2, 1.0), (7, 1, 0.76)],
)
def test_figures_shrink_where_that_saves_a_page_that_is_hardly_begun(
    tmp_path: Path, count: int, page: int, scale: float
) -> None:
    assert (found := set_page(tmp_path, count))["page"] == page, found
    assert found["scale"] == scale
