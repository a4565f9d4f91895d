"""The PDFs of all problems under all laws have no warning, and no page less than half full."""

from __future__ import annotations

import io
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from ocp import solve, store
from problems import names, spec
from reports.documents import pdf

PAPER, TOP, BOTTOM = 297.0, 20.0, 24.0
"""Height of a page and of its margins [mm], as in ``reports/documents/templates/common.typ``."""


@pytest.mark.costly
@pytest.mark.parametrize("law", ["exact", "barrier", "adaptive", "randomized"])
@pytest.mark.parametrize("name", names())
def test_pages_are_drawn_without_a_warning_and_are_filled(
    name: str, law: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After two iterations a plan has every panel, and a replay with another motion."""
    found = solve(spec(name).problem({"N": "8"}), contact=law, settings={"max_iter": 2})
    run = store.load(store.save(found, tmp_path, []).path)
    set_page = pdf.typst.compile

    def as_pictures(*arguments: Any, **options: Any) -> Any:
        return set_page(*arguments, **{"format": "png", "ppi": 36, **options})

    monkeypatch.setattr(pdf.typst, "compile", as_pictures)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        pages: Any = pdf.render_pdf([run])
    full = [filled(page) for page in ([pages] if isinstance(pages, bytes) else pages)]
    assert len(full) >= 2 and min(full[:-1]) > 0.5, full


def filled(page: bytes) -> float:
    """Return the filled share of a page's height within its margins, down to the last line of text."""
    with Image.open(io.BytesIO(page)) as picture:
        dark = np.asarray(picture.convert("L")) < 200
    body = dark[: int(len(dark) * (PAPER - BOTTOM) / PAPER)]
    last = np.flatnonzero(body.any(axis=1)).max(initial=0)
    return float(last / len(dark) * PAPER - TOP) / (PAPER - TOP - BOTTOM)
