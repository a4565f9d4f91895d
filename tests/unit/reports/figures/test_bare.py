"""Bare figures: width of a column, lettered panels, single panels, embedded fonts, reproducible files."""

from __future__ import annotations

import io
import re
import shutil
import subprocess
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from ocp.errors import InputError
from reports.figures.paper import BOTH_COLUMNS_IN, COLUMN_IN, panel_axes, render_figure

COLORS = ("#ff0000", "#00ff00", "#0000ff", "#ff00ff")


def four(**shared) -> Figure:
    """Return a figure of four panels, each with a line of its own colour, and a legend of all lines above them."""
    figure = Figure(figsize=(6.5, 4.0))
    for axis, color in zip(figure.subplots(2, 2, **shared).ravel(), COLORS, strict=True):
        axis.plot([0, 1], [0, 1], color=color, linewidth=3, label=color)
    for axis in figure.axes[2:]:
        axis.set_xlabel("time [s]")
    figure.axes[0].set_ylabel("height [m]")
    figure.axes[1].set_title("right", loc="left")
    figure.legend(loc="outside upper center", ncols=4)
    return figure


def pixels(content: bytes) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(content)).convert("RGB"), dtype=int)


def pure(picture: np.ndarray) -> set[str]:
    """Return the colours of those lines that a picture shows."""
    flat = picture.reshape(-1, 3)
    return {
        c for c in COLORS if (np.abs(flat - [int(c[k : k + 2], 16) for k in (1, 3, 5)]) < 9).all(axis=1).sum() > 200
    }


def words(svg: bytes) -> list[str]:
    """Return the texts of an SVG, which matplotlib writes as comments."""
    return re.findall(r"<!-- (.+?) -->", svg.decode())


@pytest.mark.costly
def test_several_panels_are_as_wide_as_both_columns_and_lettered_in_order() -> None:
    figure = four()
    picture = pixels(render_figure(figure, "png"))
    assert picture.shape[1] == pytest.approx(300 * BOTH_COLUMNS_IN, abs=1)
    titles = [axis.get_title("left") for axis in panel_axes(figure)]
    assert titles == ["(a)", "(b) right", "(c)", "(d)"]
    assert pure(picture) == set(COLORS)


def test_one_panel_keeps_its_shape_and_needs_no_letter() -> None:
    figure = Figure(figsize=(6.5, 3.25))
    figure.subplots().plot([0, 1])
    picture = pixels(render_figure(figure, "png"))
    assert picture.shape[:2] == pytest.approx((300 * COLUMN_IN / 2, 300 * COLUMN_IN), abs=1)
    assert figure.axes[0].get_title("left") == ""


@pytest.mark.costly
@pytest.mark.parametrize("letter", ["a", "b", "c", "d"])
def test_a_panel_alone_is_that_panel_a_column_wide(letter: str) -> None:
    figure = four()
    place = "abcd".index(letter)
    chosen = figure.axes[place]
    picture = pixels(render_figure(figure, "png", letter))
    assert picture.shape[1] == pytest.approx(300 * COLUMN_IN, abs=9)
    assert [axis.get_visible() for axis in figure.axes] == [axis is chosen for axis in figure.axes]
    # The legend below names all four with short strokes; the panel's own line is the long one.
    own = [int(COLORS[place][k : k + 2], 16) for k in (1, 3, 5)]
    seen = (np.abs(picture - own) < 9).all(axis=-1)
    assert np.ptp(np.flatnonzero(seen.any(axis=0))) > 0.7 * picture.shape[1]
    assert pure(picture) == set(COLORS)
    legend = chosen.get_legend()
    assert legend is not None and [t.get_text() for t in legend.get_texts()] == list(COLORS)
    below = legend.get_window_extent().y1
    assert below <= chosen.xaxis.get_tightbbox().y0 + 1, "the key hides no label"


@pytest.mark.costly
def test_a_panel_gets_the_labels_that_it_left_to_its_neighbours() -> None:
    figure = four(sharex=True, sharey=True)
    chosen = figure.axes[1]
    assert chosen.get_xlabel() == chosen.get_ylabel() == ""
    told = words(render_figure(figure, "svg", "b"))
    assert "time [s]" in told and "height [m]" in told and "right" in told
    assert {"0.0", "1.0"} <= set(told), "its ticks have numbers"


@pytest.mark.costly
def test_a_label_of_another_scale_is_not_lent() -> None:
    figure = four()
    figure.axes[1].set_ylim(0, 7)
    assert "height [m]" not in words(render_figure(figure, "svg", "b"))


@pytest.mark.costly
def test_a_panel_over_the_whole_width_gets_both_columns() -> None:
    figure = Figure(figsize=(6.5, 4.0))
    grid = figure.add_gridspec(2, 2)
    for place in (grid[0, :], grid[1, 0], grid[1, 1]):
        figure.add_subplot(place).plot([0, 1])
    assert pixels(render_figure(figure, "png", "a")).shape[1] == pytest.approx(300 * BOTH_COLUMNS_IN, abs=9)


@pytest.mark.costly_cases("-a to d")
@pytest.mark.parametrize(("panel", "said"), [("e", "a to d"), ("ab", "a to d"), ("", "a to d")])
def test_an_unknown_panel_is_told_the_known_ones(panel: str, said: str) -> None:
    with pytest.raises(InputError, match=f"unknown panel '{panel}'; the figure has {said}"):
        render_figure(four(), "pdf", panel)


def test_an_unknown_format_is_told_the_known_ones() -> None:
    with pytest.raises(InputError, match=r"unknown format 'eps'.*there are pdf, svg, png"):
        render_figure(four(), "eps")


@pytest.mark.costly
@pytest.mark.parametrize("ending", ["pdf", "svg", "png"])
def test_the_same_figure_is_the_same_bytes(ending: str) -> None:
    mpl.rcParams["svg.hashsalt"] = "same"
    assert render_figure(four(), ending, "a") == render_figure(four(), ending, "a")
    assert render_figure(four(), ending) == render_figure(four(), ending)


@pytest.mark.costly
def test_no_font_of_a_pdf_is_of_type_3() -> None:
    content = render_figure(four(), "pdf")
    assert b"/Type3" not in content and b"/FontFile2" in content


@pytest.mark.costly
@pytest.mark.skipif(shutil.which("pdffonts") is None, reason="there is no pdffonts")
def test_all_fonts_of_a_pdf_are_embedded(tmp_path: Path) -> None:
    (tmp_path / "f.pdf").write_bytes(render_figure(four(), "pdf"))
    told = subprocess.run(["pdffonts", str(tmp_path / "f.pdf")], capture_output=True, text=True, check=True)
    head, _, *fonts = told.stdout.splitlines()
    column = head.index("emb")
    assert fonts and all(font[column : column + 3] == "yes" for font in fonts), told.stdout
    assert all("TrueType" in font for font in fonts)
