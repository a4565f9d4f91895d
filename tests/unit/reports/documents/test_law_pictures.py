"""The picture of a contact law: the central path or, for the exact law, impulses and gaps over time."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.patches import Rectangle

from reports.drawing.style import CYCLE, SKY, line_of
from reports.figures import run as figures
from reports.figures.panels import draw_rows
from reports.figures.trajectories import plan_rows
from tests.unit.reports.documents.made import run, waves

N = 10
PUSH = np.array([0, 0, 1.0, 2.0, 1.0, 0, 0, 3.0, 0, 0])
GAP = np.where(PUSH > 0, 0.0, 0.2)


def exact(contacts: dict[str, np.ndarray], gaps: np.ndarray, **more):
    return run(waves(1, "m", N + 1, "x"), waves(1, "N", N, "u"), contacts, gap=gaps, **more)


def test_impulse_above_gap_below_and_contact_shaded() -> None:
    gaps = np.stack([GAP, np.ones(N)], axis=-1)[None]
    view = exact({"toe [N s]": PUSH[None], "heel [N s]": np.zeros((1, N))}, gaps)
    assert not figures.is_before_path_end(view)
    rows, columns = figures.rows_of_contacts(view)
    assert columns == 1, "heel never pushes"
    above, below = draw_rows(rows, columns, 0.6).axes
    assert above.get_title("left") == "toe [N s]"
    for axis, values in ((above, PUSH), (below, GAP)):
        drawn = next(line for line in axis.lines if len(line.get_xdata()) > 2)
        np.testing.assert_array_equal(np.asarray(drawn.get_ydata())[:-1], values)
        spans = [(p.get_x(), p.get_width()) for p in axis.patches if isinstance(p, Rectangle)]
        assert spans == [pytest.approx((0.2, 0.3)), pytest.approx((0.7, 0.1))]
        assert to_rgb(axis.patches[0].get_facecolor()) == pytest.approx(to_rgb(SKY))


def test_force_at_a_distance_is_drawn_and_not_shaded() -> None:
    push, gap = np.full(N, 1e-2), np.full(N, 1e-1)
    push[3], gap[3] = 1e-1, 1e-2
    view = exact({"wall [N s]": push[None]}, gap[None, :, None], mu=1e-3)
    above, below = draw_rows(*figures.rows_of_contacts(view)).axes
    for axis in (above, below):
        spans = [(p.get_x(), p.get_width()) for p in axis.patches if isinstance(p, Rectangle)]
        assert spans == [pytest.approx((0.3, 0.1))]


def test_a_replay_is_dashed_where_it_differs() -> None:
    gaps = GAP[None, :, None]
    same, other = (
        draw_rows(
            *figures.rows_of_contacts(
                exact({"toe [N s]": PUSH[None]}, gaps, replay={"lam": factor * PUSH[None, :, None]})
            )
        ).axes[0]
        for factor in (1.0, 0.5)
    )
    assert [line.get_linestyle() for line in same.lines] == ["-"]
    assert [line.get_linestyle() for line in other.lines] == ["-", "--"]
    np.testing.assert_array_equal(np.asarray(other.lines[1].get_ydata())[:-1], PUSH / 2)


@pytest.mark.one_case_in(2)
@pytest.mark.parametrize("values", [(0.0, 0.0), (1.0, 1.0), (1e-300, 1e300), (0.0, np.nan)])
@pytest.mark.filterwarnings("error")
def test_odd_numbers_are_drawn_without_a_warning(values: tuple[float, float]) -> None:
    push, other = (np.full((1, N), value) for value in values)
    view = exact({"toe [N s]": push}, other[..., None], mu=1e-3, replay={"lam": other[..., None]})
    assert figures.is_before_path_end(view) == bool(values == (1.0, 1.0))
    rows, columns = figures.rows_of_contacts(view)
    for figure in [*([draw_rows(rows, columns)] if rows else []), draw_rows(plan_rows(view))]:
        figure.draw_without_rendering()


def test_a_smoothed_law_is_no_end_and_its_points_lie_on_the_path() -> None:
    lam = np.geomspace(1e-3, 1, N)
    view = exact({"toe [N s]": lam[None]}, (1e-3 / lam)[None, :, None], mu=1e-3)
    assert figures.is_before_path_end(view)
    (axis,) = figures.contact_plane(view).axes
    points = next(line for line in axis.lines if line.get_label() == "toe")
    np.testing.assert_allclose(np.prod(points.get_data(), axis=0), 1e-3)
    low, high = axis.get_xlim()
    assert low > 1e-4 and high < 10, "no room for what is not drawn"


def test_what_lies_below_the_floor_is_counted_and_not_drawn() -> None:
    lam = np.array([0.0, 1e-15, *np.geomspace(1e-3, 1, N - 2)])
    view = exact({"toe [N s]": lam[None]}, np.full((1, N, 1), 1e-3), mu=1e-3)
    (axis,) = figures.contact_plane(view).axes
    points = next(line for line in axis.lines if line.get_label() == "toe")
    assert np.nansum(np.isfinite(points.get_ydata())) == N - 2
    assert axis.get_title("left").startswith("2 of 10 points")


def test_twelve_contacts_have_twelve_colours_that_stay_apart() -> None:
    contacts = {f"c{i} [N s]": np.full((1, N), 0.1 + i) for i in range(12)}
    view = exact(contacts, np.full((1, N, 12), 1e-2), mu=1e-3)
    (axis,) = figures.contact_plane(view).axes
    colors = [line.get_color() for line in axis.lines if str(line.get_label()).startswith("c")]
    assert len(colors) == 12 == len(set(colors))
    distances = [np.linalg.norm(lab(a) - lab(b)) for a, b in itertools.combinations(CYCLE, 2)]
    assert min(distances) > 20, "2.3 is the least that an eye can tell"


def test_lines_stay_apart_in_grey_print() -> None:
    """Lines differ by eight steps of CIE lightness, where two steps are visible, or by their style."""
    for first, second in itertools.combinations(map(line_of, range(12)), 2):
        apart = abs(lab(first["color"])[0] - lab(second["color"])[0])
        assert apart >= 8 or first["linestyle"] != second["linestyle"], (first, second)
    lightness = [lab(color)[0] for color in CYCLE[:6]]
    assert max(lightness) < 80, "seen on white"


def lab(color: str) -> np.ndarray:
    """Return the CIE L*a*b* coordinates of a colour under D65, whose distances match perception."""
    rgb = np.array(to_rgb(color))
    linear = np.where(rgb > 0.04045, ((rgb + 0.055) / 1.055) ** 2.4, rgb / 12.92)
    to_xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
    xyz = to_xyz @ linear / np.array([0.95047, 1, 1.08883])
    f = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16 / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])
