"""Reports have the same bytes for the same run, all parts in order, and units on every axis."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from ocp import store
from ocp.errors import InputError
from problems import names, spec
from reports.documents.citations import full_citation
from reports.documents.comparison import continuation_page
from reports.documents.pdf import render_pdf, write_pdf
from reports.documents.solve import solve_page
from reports.drawing.style import house_style, to_svg
from reports.drawing.view import RunView
from reports.figures import run as figures
from reports.tables.console import shown_stages


@pytest.fixture(scope="module")
def views(store_of_runs: Path) -> dict[str, RunView]:
    found = {}
    for entry in store.list_runs(store_of_runs):
        view = RunView.of(store.load(entry.path))
        record = view.run.record
        found[f"{view.run.kind} {view.run.meta['problem']} {record['contact']}"] = view
    return found


@pytest.mark.costly
def test_identical_runs_give_identical_bytes(ocp, tmp_path: Path) -> None:
    """The second solve is in another process with other hash seeds, at another time and in another folder."""
    arguments = ["solve", "push-1d", "--contact", "adaptive", "--quiet"]
    assert ocp(*arguments, "--pdf", "a.pdf").code == 0
    code = "import sys; from reports.cli.app import main; sys.exit(main())"
    environment = {
        **os.environ,
        "PYTHONHASHSEED": "7",
        "TZ": "Asia/Tokyo",
        "PYTHONPATH": str(Path(__file__).parents[2]),
    }
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments, "--pdf", "b.pdf", "--out", "other"],
        env=environment,
        cwd=tmp_path,
        capture_output=True,
    )
    assert done.returncode == 0, done.stderr
    first, second = (tmp_path / name for name in ("a.pdf", "b.pdf"))
    assert first.read_bytes() == second.read_bytes()
    assert first.read_bytes().startswith(b"%PDF")
    assert ocp(*arguments, "-c", "sigma=0.03", "--pdf", "c.pdf").code == 0
    assert (tmp_path / "c.pdf").read_bytes() != first.read_bytes()


def test_reports_of_stored_runs(ocp, store_of_runs: Path) -> None:
    out = ["--out", str(store_of_runs)]
    runs = [str(path) for path in (store_of_runs / "push-1d").iterdir()]
    assert len(runs) == 2
    side_by_side = ocp("report", *runs, "-o", "two.pdf", "--json", *out)
    assert side_by_side.json == {"pdf": "two.pdf", "runs": runs}
    assert Path("two.pdf").read_bytes().startswith(b"%PDF")
    assert Path("two.pdf").stat().st_mode & 0o777 == 0o644
    path = next(p for p in (store_of_runs / "wall-1d").iterdir() if "points" in (p / "meta.json").read_text())
    assert ocp("report", str(path), "-o", "path.pdf", *out).code == 0
    mixed = ocp("report", str(path), runs[0], "-o", "mixed.pdf", *out)
    assert mixed.code == 2 and "needs runs of ocp solve" in mixed.err
    assert not Path("mixed.pdf").exists()


@pytest.mark.costly
def test_equations_that_do_not_compile_are_named(views, monkeypatch) -> None:
    view = views["solve push-1d exact"]
    broken = spec("push-1d")
    monkeypatch.setattr(
        "problems.plugin.registered",
        lambda _: type(broken)(**{**vars(broken), "equations": ("nosuchsymbol",)}),
    )
    with pytest.raises(InputError, match="typst equations"):
        render_pdf([view.run])


@pytest.mark.costly
def test_a_pdf_that_cannot_be_written_leaves_nothing(views, tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("")
    with pytest.raises(InputError, match="cannot write the PDF"):
        write_pdf([views["solve push-1d exact"].run], tmp_path / "taken" / "x.pdf")
    assert [path.name for path in tmp_path.iterdir()] == ["taken"]


def test_the_page_says_what_the_run_says(views) -> None:
    view = views["solve wall-1d barrier"]
    with house_style():
        content, drawn = solve_page(view)
    assert content["verdict"] == view.run.meta["verdict"]
    assert content["grade"] == "survives"
    assert len(content["stages"]) == len(shown_stages(view.run.stages, view.run.meta["cost"])[0])
    assert "μ = 0.001" in content["law"]["place"]
    parameters = {row[0]: row[1:] for row in content["parameters"]}
    assert parameters["h"] == ["0.1", "s", "step size"]
    assert parameters["w_v"][1] == "s²/m²"
    assert ["seed", "0"] in content["settings"]
    assert set(drawn) == {"motion-01", "contact", "contacts-01", "strobe", "homotopy"}
    assert "Suh" in content["citation"]
    text = str(content)
    assert "seconds" not in text and "solve_s" not in text, "times differ from run to run"


@pytest.mark.costly
def test_the_exact_law_lies_at_the_end_of_the_path(views) -> None:
    with house_style():
        content, _ = solve_page(views["solve push-1d exact"])
    assert "μ = 0" in content["law"]["place"]


@pytest.mark.costly
def test_feedback_has_its_gains_and_all_scenarios(views) -> None:
    view = views["solve push-disc barrier"]
    with house_style():
        _, drawn = solve_page(view)
    ox = next(axis for axis in drawn["motion-01"].axes if axis.get_title("left") == "ox [m]")
    planned_and_replayed = [line for line in ox.lines if len(line.get_xdata()) > 2]
    assert len(planned_and_replayed) == 2 * 3
    pictures = [axis.get_title("left") for axis in drawn["strobes-01"].axes]
    assert pictures == ["scenario 0", "scenario 1", "scenario 2"]
    K = view.run.data["K"].values
    maps = [axis.collections[0] for axis in drawn["gains"].axes[: K.shape[1]]]
    for control, map_ in enumerate(maps):
        np.testing.assert_allclose(np.asarray(map_.get_array()), K[:, control, :].T)


@pytest.mark.costly_cases("solve push-disc barrier")
@pytest.mark.parametrize("name", ["solve wall-1d barrier", "solve push-disc barrier"])
def test_every_axis_has_a_unit(views, name: str) -> None:
    view = views[name]
    with house_style():
        _, drawn = solve_page(view)
    assert view.spec is not None
    picture = drawn.get("strobe", drawn.get("strobes-01"))
    assert picture is not None
    assert (picture.axes[0].get_xlabel(), picture.axes[0].get_ylabel()) == view.spec.axes
    (plane,) = drawn["contact"].axes
    assert re.search(r"\[.+\]", plane.get_ylabel()) and re.search(r"\[.+\]", plane.get_xlabel())
    rows = [figure for key, figure in drawn.items() if key.startswith("motion-")]
    panels = [axis for figure in rows for axis in figure.axes if axis.get_title("left")]
    assert panels and all(re.search(r"\[.+\]", axis.get_title("left")) for axis in panels)
    below = [axis.get_xlabel() for figure in rows for axis in figure.axes if axis.get_xlabel()]
    assert set(below) == {"time [s]"}


def test_the_contact_plane_draws_the_central_path_and_the_points(views) -> None:
    view = views["solve wall-1d barrier"]
    with house_style():
        (axis,) = figures.contact_plane(view).axes
    path = next(line for line in axis.lines if "gap = " in str(line.get_label()))
    gap, lam = (np.asarray(values) for values in path.get_data())
    np.testing.assert_allclose(lam * gap, 1e-3, rtol=1e-12)
    points = next(line for line in axis.lines if line.get_label() == "wall")
    gap, lam = (np.asarray(values) for values in points.get_data())
    assert len(gap) == 30
    np.testing.assert_allclose(lam * gap, 1e-3, rtol=1e-6)
    assert (axis.get_xscale(), axis.get_yscale()) == ("log", "log")


def test_the_continuation_page(views) -> None:
    view = views["continue wall-1d barrier"]
    with house_style():
        content, drawn = continuation_page(view)
    assert len(content["points"]) == len(view.run.meta["points"])
    assert content["over"] == "μ [N s m]" and content["request"][0][0] == "μ"
    assert ["law", "barrier"] in content["request"], "mu is no constant of the path"
    assert not [row for row in content["settings"] if row[0] == "contact.mu"]
    top, middle, _ = drawn["path"].axes
    value, complementarity = (np.asarray(v) for v in middle.lines[0].get_data())
    np.testing.assert_allclose(complementarity, value, rtol=1e-5)
    assert "[N s m]" in drawn["path"].axes[-1].get_xlabel()
    assert top.get_xscale() == "log"


def test_events_are_marked_and_listed_on_the_continuation_page(views, monkeypatch: pytest.MonkeyPatch) -> None:
    view = views["continue wall-1d barrier"]
    shared = {"cost": 17.8, "change": "touches", "contact": "wall", "steps": [3]}
    events = [
        {"kind": "contact", "value": 2e-3, **shared},
        {"kind": "bound", "value": 3e-3, **shared},
        {"kind": "fold", "value": 5e-3, **shared, "contact": "", "steps": [], "change": "turns"},
    ]
    monkeypatch.setitem(view.run.meta, "events", events)
    with house_style():
        content, drawn = continuation_page(view)
    assert [row[:5] for row in content["events"]] == [
        ["1", "0.002", "contact", "wall touches", "3"],
        ["2", "0.005", "fold", "turns", ""],
    ]
    top, middle, _ = drawn["path"].axes
    assert [text.get_text() for text in top.texts] == ["1", "2"]
    marked = [np.asarray(line.get_xdata())[0] for line in middle.lines[1:]]
    assert marked == [2e-3, 5e-3]


def test_an_svg_has_no_date_and_no_fonts_to_find() -> None:
    with house_style():
        figure = Figure()
        figure.subplots().set_xlabel("x [m]")
        first, second = to_svg(figure), to_svg(figure)
    assert first == second
    assert b"<dc:date>" not in first
    assert b"<text" not in first


def test_citations() -> None:
    for name in names():
        citation = spec(name).citation
        assert citation is not None
        assert full_citation(citation.key) != citation.key, "the bibliography lacks this key"
    assert full_citation("suh2023noising") == (
        "Suh HT, Simchowitz M, Pang T, Tedrake R (2023) How Does Noising Data Affect Learned Contact Dynamics?"
    )
    assert "SIAM Journal on Numerical Analysis 40:702–733" in full_citation("paoli2002numerical")
    assert full_citation("somebody2030") == "somebody2030"
