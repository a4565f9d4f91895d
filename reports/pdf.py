"""A PDF from stored runs: pages set by typst, figures as vectors, the same bytes each time."""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import typst
from matplotlib.figure import Figure

from ocp.errors import InputError
from ocp.store import atomic
from ocp.store.plain import plain
from ocp.store.stored_run import StoredRun
from problems.spec import ProblemSpec
from reports.pages import (
    comparison_page,
    continuation_page,
    estimate_page,
    solve_page,
    study_page,
    sweep_page,
    training_page,
)
from reports.style import literal, styled, to_svg
from reports.view import RunView

_TEMPLATES = Path(__file__).with_name("templates")


def write_pdf(
    runs: Sequence[StoredRun], path: Path, cones: bool = False, own: ProblemSpec | None = None
) -> None:
    """Write a report of one run, or of several solves or trainings, to ``path``.

    Friction cones are drawn where ``cones``; ``own`` is the problem in a file that a person named.
    Raises :class:`~ocp.errors.InputError` where the file cannot be written, where runs cannot be
    compared, or where a problem's typst equations do not compile.
    """
    atomic.write(path, render(runs, cones, own), "the PDF")


def render(runs: Sequence[StoredRun], cones: bool = False, own: ProblemSpec | None = None) -> bytes:
    """Return the PDF's bytes."""
    views = [RunView.of(run, own) for run in runs]
    with styled():
        template, content, figures = _page(views, cones, own)
        if template != "study.typ":
            figures = {name: literal(figure) for name, figure in figures.items()}
        drawn = {name: to_svg(figure) for name, figure in figures.items()}
    return _typeset(template, content, drawn)


def _page(
    views: list[RunView], cones: bool, own: ProblemSpec | None
) -> tuple[str, dict[str, Any], dict[str, Figure]]:
    kinds = {view.run.kind for view in views}
    if kinds == {"solve"}:
        if len(views) == 1:
            return ("solve.typ", *solve_page(views[0], cones))
        return ("comparison.typ", *comparison_page(views, cones))
    if kinds == {"continue"} and len(views) == 1:
        return ("continuation.typ", *continuation_page(views[0], cones))
    if kinds == {"sweep"} and len(views) == 1:
        return ("sweep.typ", *sweep_page(views[0]))
    if kinds == {"estimate"} and len(views) == 1:
        return ("estimate.typ", *estimate_page(views[0].run, own))
    if kinds == {"figure"} and len(views) == 1:
        return ("study.typ", *study_page(views[0].run))
    if kinds == {"train"}:
        return ("training.typ", *training_page(views))
    raise InputError(
        "only runs of ocp solve, or of ocp train, can stand side by side in a report; give the"
        " others one by one"
    )


def _typeset(template: str, content: dict[str, Any], figures: dict[str, bytes]) -> bytes:
    with tempfile.TemporaryDirectory(prefix="centralpath-") as folder:
        root = Path(folder)
        for file in _TEMPLATES.glob("*.typ"):
            shutil.copy(file, root)
        for name, svg in figures.items():
            (root / f"{name}.svg").write_bytes(svg)
        content = {**content, "figures": sorted(figures)}
        (root / "content.json").write_text(json.dumps(plain(content)))
        try:
            return typst.compile(str(root / template), root=folder, ignore_system_fonts=True)
        except typst.TypstError as error:
            raise InputError(
                f"the report does not compile: {error}; check the problem's typst equations"
            ) from error
