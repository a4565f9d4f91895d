"""The report on contacts agrees with the stored arrays."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_hex
from matplotlib.patches import Rectangle
from rich.console import Console

from dynamics.contact import Exact
from ocp import solve, store
from ocp.judge.audit import Audit
from ocp.judge.contact_report import ContactSummary, active_contacts
from problems import spec
from reports.cli.solve_command import solution_document
from reports.documents.solve import solve_page
from reports.drawing.style import ORANGE, SKY, house_style
from reports.drawing.view import RunView
from reports.figures.panels import draw_rows
from reports.figures.run import rows_of_contacts
from reports.tables import console
from reports.tables.contacts import contact_table, spans_text


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> tuple[Path, RunView]:
    problem = spec("planar-push").problem({})
    path = store.save(solve(problem, contact=Exact()), tmp_path_factory.mktemp("runs"), []).path
    return path, RunView.of(store.load(path))


def array(view: RunView, name: str) -> np.ndarray:
    found = view.array(name)
    assert found is not None
    return found


@pytest.mark.costly
def test_summary_adds_up_what_the_run_stores(run) -> None:
    view = run[1]
    (push,) = view.run.audit.contacts
    h = np.diff(view.time)
    acts, slides = array(view, "active")[0, :, 0], array(view, "slipping")[0, :, 0]
    impulse, slip = array(view, "normal_impulse")[0, :, 0], array(view, "slip")[0, :, 0]
    assert push.peak_force == pytest.approx(np.max(impulse / h), rel=1e-12)
    assert push.slid == pytest.approx(np.sum(np.abs(slip) * h * acts), rel=1e-12)
    assert push.slid > 0.01, "the pusher slides along the box"
    inside = {k for first, last in push.spans for k in range(first, last + 1)}
    assert inside == set(np.flatnonzero(acts)) and len(inside) == push.steps
    assert push.slipping == slides.sum() < push.steps
    assert push.degenerate == array(view, "degenerate").sum()


@pytest.mark.costly
def test_a_multiplier_in_newton_is_the_force() -> None:
    found = solve(spec("cart-walls").problem({}), contact=Exact())
    peaks = [summary.peak_force for summary in found.audit.contacts]
    assert peaks == pytest.approx(found.data["lam"].values.max(axis=(0, 1)), abs=1e-12)
    assert max(peaks) > 1


@pytest.mark.costly
def test_friction_holds_or_slips_at_its_bound(run) -> None:
    """Coulomb's law is checked on the stored arrays alone."""
    view = run[1]
    friction, bound, slip = (array(view, name).ravel() for name in ("friction_impulse", "friction_bound", "slip"))
    slides = array(view, "slipping").ravel() > 0
    assert bound == pytest.approx(2 / 3 * array(view, "normal_impulse").ravel(), rel=1e-12)
    assert np.all(np.abs(friction) <= bound + 1e-9)
    np.testing.assert_allclose(np.abs(friction[slides]), bound[slides], atol=1e-8)
    assert np.all(friction[slides] * slip[slides] < 0)


@pytest.mark.costly
def test_json_has_the_contacts_and_the_books(run) -> None:
    view = run[1]
    problem = view.problem
    assert problem is not None
    told = solution_document(view.run.solution(problem), view.run.meta)
    (push,) = told["contacts"]
    assert push["steps"] == array(view, "active").sum()
    assert 0 <= told["cone_violation"] < 1e-9 and 0 <= told["dissipation_residual"] < 1e-9


@pytest.mark.costly
def test_figure_draws_impulses_within_their_bound(run) -> None:
    view = run[1]
    axis, _ = draw_rows(*rows_of_contacts(view)).axes
    assert axis.get_title("left") == "push [N s]"
    drawn = [np.asarray(line.get_ydata())[:-1] for line in axis.lines if len(line.get_xdata()) > 2]
    for values, name in zip(drawn, ("friction_impulse", "normal_impulse"), strict=True):
        np.testing.assert_allclose(values, array(view, name)[0, :, 0], rtol=1e-12)
    (band,) = (c for c in axis.collections if isinstance(c, PolyCollection))
    heights = band.get_paths()[0].vertices[:, 1]
    largest = np.max(array(view, "friction_bound")[0, :, 0])
    assert (heights.min(), heights.max()) == pytest.approx((-largest, largest))
    low, high = axis.get_ylim()
    assert low <= -largest and high >= largest, "the band is seen whole"


def test_shading_covers_the_steps_that_slip_and_those_that_stick(run) -> None:
    view = run[1]
    axis, _ = draw_rows(*rows_of_contacts(view)).axes
    spans = [patch for patch in axis.patches if isinstance(patch, Rectangle)]
    width = dict.fromkeys((ORANGE, SKY), 0.0)
    for span in spans:
        width[to_hex(span.get_facecolor()).upper()] += span.get_width()
    slides = array(view, "slipping")[0, :, 0] > 0
    h = np.diff(view.time)
    assert width[ORANGE] == pytest.approx(h[slides].sum())
    assert width[SKY] == pytest.approx(h[~slides].sum()), "the pusher never leaves the box"


def test_page_has_the_contact_that_acts(run) -> None:
    with house_style():
        content, figures = solve_page(run[1])
    (row,) = content["contacts"]
    told = dict(zip(content["contact_heads"], row, strict=True))
    assert (told["contact"], told[">active"], told["at steps"]) == ("push", "20", "0-19")
    panels = [axis.get_title("left") for figure in figures.values() for axis in figure.axes]
    assert panels.count("push [N s]") == 1, "an impulse is drawn once"
    residuals = {group["title"]: group["rows"] for group in content["key"]}["Residuals"]
    assert any(name == "friction cone [N s]" for name, _ in residuals)
    force = array(run[1], "normal_impulse") / np.diff(run[1].time)[:, None]
    assert float(told[">peak [N]"]) == pytest.approx(force.max(), rel=1e-3), "as on the console"


def test_a_smoothed_contact_is_active_or_pushes_at_a_distance_and_never_both() -> None:
    """On the central path lam gap = mu, so that an impulse above its gap is above sqrt(mu)."""
    lam = np.geomspace(1e-9, 1.0, 50)
    active, distant = active_contacts(lam, 1e-4 / lam)
    np.testing.assert_array_equal(active, lam > 1e-2)
    np.testing.assert_array_equal(distant, (lam > 1e-6) & (lam <= 1e-2))
    shares = active_contacts(np.array([np.nan, 0.0, 1.0, 1.0]), np.array([np.nan, 0.0, 0.0, 2.0]))
    np.testing.assert_array_equal(shares, [[0, 0, 1, 0], [0, 0, 0, 1]])


def test_force_at_a_distance_has_its_name_and_column() -> None:
    near, far = (ContactSummary(name, n, 0, 1.0, 0.0, 0, [], 5 - n) for name, n in (("a", 5), ("b", 0)))
    assert "distant" not in shown(made(near)) and "force at a distance" not in shown(made(near))
    text = shown(made(near, far))
    assert "distant" in text and "force at a distance" in " ".join(text.split())
    assert "never" not in text, "b pushes"


def made(*contacts: ContactSummary, cone: float = 0.0) -> Audit:
    return Audit(*(0.0,) * 9, 0, 0.0, cone_violation=cone, contacts=list(contacts))


def shown(audit: Audit) -> str:
    printer = Console(width=console.TERMINAL_COLUMNS, record=True, file=io.StringIO())
    printer.print(contact_table(audit))
    return printer.export_text()


def test_table_has_only_what_acts_and_counts_the_rest() -> None:
    toe = ContactSummary("toe", 8, 3, 491.13, 0.25, 1, [(0, 4), (7, 7), (9, 10)])
    idle = [ContactSummary(name, 0, 0, 0.0, 0.0, weak) for name, weak in (("torso", 0), ("leg", 2))]
    text = shown(made(toe, *idle))
    assert "0-4, 7, 9-10" in text and "491.1" in text and "slid" in text
    assert "torso" not in text and "2 contacts never active, degenerate at 2 steps" in text
    smooth = shown(made(toe, cone=float("nan")))
    assert "slid" not in smooth and "never" not in smooth


def test_many_spans_are_cut_short() -> None:
    spans = [(k, k) for k in range(0, 20, 2)]
    assert spans_text(spans) == "0, 2, 4, 6, 8, 10, 4 more"
