"""PDF reports of stored runs, typeset by typst with vector figures, byte for byte reproducible."""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import typst
from matplotlib.figure import Figure

from ocp.errors import InputError
from ocp.store import atomic
from ocp.store.json_values import to_json
from ocp.store.stored_run import StoredRun
from problems.spec import ProblemSpec
from reports.drawing.style import house_style, show_literally, to_svg
from reports.drawing.view import RunView

_TEMPLATES = Path(__file__).with_name("templates")
"""Folder of the typst templates."""


def write_pdf(
    runs: Sequence[StoredRun],
    path: Path,
    cones: bool = False,
    file_spec: ProblemSpec | None = None,
    signals: str | None = None,
) -> None:
    """Write a report of one run, or of several solves, trainings or closed loops.

    ``cones`` draws friction cones; ``file_spec`` is the problem of a user's file; ``signals`` are the names of
    the drawn signals of a solve (all if None). Raises :class:`~ocp.errors.InputError` if the file cannot be
    written, if runs cannot be compared, or if a problem's typst equations do not compile.
    """
    atomic.write_file(path, render_pdf(runs, cones, file_spec, signals), "the PDF")


def render_pdf(
    runs: Sequence[StoredRun], cones: bool = False, file_spec: ProblemSpec | None = None, signals: str | None = None
) -> bytes:
    """Return the bytes of the PDF that :func:`write_pdf` writes."""
    views = [RunView.of(run, file_spec) for run in runs]
    with house_style():
        template, content, figures = _page(views, cones, file_spec, signals)
        if template != "study.typ":
            figures = {name: show_literally(figure) for name, figure in figures.items()}
        svg_figures = {name: to_svg(figure) for name, figure in figures.items()}
    return _typeset(template, content, svg_figures)


PAGES = {
    "solve": "reports.documents.solve.solve_page",
    "continue": "reports.documents.comparison.continuation_page",
    "sweep": "reports.documents.sweep.sweep_page",
    "estimate": "reports.documents.sweep.estimate_page",
    "gradients": "reports.documents.gradients.gradients_page",
    "figure": "reports.documents.study.study_page",
    "train": "reports.documents.training.training_page",
    "closed-loop": "reports.documents.closed_loop.loops_page",
}
"""Mapping from the kind of a run to the function that makes its page; the function is imported at its first use."""
_TEMPLATE_OF_KIND = {"continue": "continuation", "figure": "study", "train": "training"}
"""Mapping from kinds of run to their templates, for templates with a name other than the kind."""


def _page(
    views: list[RunView], cones: bool, file_spec: ProblemSpec | None, signals: str | None
) -> tuple[str, dict[str, Any], dict[str, Figure]]:
    """Return the template's file, the content and the figures of the report on the views."""
    kinds = {view.run.kind for view in views}
    if signals is not None and (kinds != {"solve"} or len(views) > 1):
        raise InputError("--signals is for the report of one run of ocp solve; drop it")
    if kinds == {"solve"} and len(views) > 1:
        from reports.documents.comparison import comparison_page

        return ("comparison.typ", *comparison_page(views, cones))
    if len(kinds) > 1 or (len(views) > 1 and not kinds <= {"train", "closed-loop"}):
        raise InputError(
            "a report of several runs needs runs of ocp solve, of ocp train or of ocp mpc; report the others one by one"
        )
    (kind,) = kinds
    module, _, name = PAGES[kind].rpartition(".")
    page = getattr(import_module(module), name)
    page_arguments: dict[str, tuple[Any, ...]] = {
        "solve": (views[0], cones, signals),
        "continue": (views[0], cones),
        "sweep": (views[0],),
        "estimate": (views[0].run, file_spec),
        "gradients": (views[0].run,),
        "figure": (views[0].run,),
        "train": (views,),
        "closed-loop": (views,),
    }
    return (f"{_TEMPLATE_OF_KIND.get(kind, kind)}.typ", *page(*page_arguments[kind]))


_SCALES = (1.0, 0.94, 0.88, 0.82, 0.76)
"""Scales of the figures, tried in this order until the last page is at least half full."""
_TEXT_TOP_PT = 57.0
"""Distance of the first line from the top of the page [pt]."""
_TEXT_HEIGHT_PT = 717.0
"""Height of the text block [pt]."""


def _with_full_pages(root: Path, template: str, content: dict[str, Any]) -> bytes:
    """Return the PDF with the largest scale of figures that fills half of the last page, or unscaled if none does.

    Raises ``typst.TypstError`` for content that does not compile.
    """
    file, options = str(root / template), {"root": str(root), "ignore_system_fonts": True}
    for scale in (*_SCALES, 1.0):
        (root / "content.json").write_text(json.dumps(to_json({**content, "scale": scale})))
        end = json.loads(typst.query(file, "<end>", field="value", one=True, **options))
        if end["page"] == 1 or end["y"] > _TEXT_TOP_PT + _TEXT_HEIGHT_PT / 2:
            break
    return typst.compile(file, **options)


def _typeset(template: str, content: dict[str, Any], figures: dict[str, bytes]) -> bytes:
    with tempfile.TemporaryDirectory(prefix="centralpath-") as folder:
        root = Path(folder)
        for file in _TEMPLATES.glob("*.typ"):
            shutil.copy(file, root)
        for name, svg in figures.items():
            (root / f"{name}.svg").write_bytes(svg)
        content = {**content, "figures": sorted(figures)}
        try:
            return _with_full_pages(root, template, content)
        except typst.TypstError as error:
            raise InputError(f"the report does not compile: {error}; check the problem's typst equations") from error
