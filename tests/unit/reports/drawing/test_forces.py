"""Drawn forces: normal and tangent add up, arrows are to scale, cones have the right angle."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Annotation

from ocp.labelled import LabelledArrays
from problems.drawing import ContactFrame
from reports.drawing.strobe import cone_stroke, draw_force, forces_of, strobe
from tests.unit.reports.made import sliding_box

NORMAL = np.array([[1.0, 2.0], [0.5, 0.0], [4.0, 1.0]])
SLIP = np.array([[-0.5, 1.0], [0.1, 0.0], [-1.0, 0.0]])

CONE_ORDER = cone_stroke(ContactFrame(0, 0, 0, 1), 1.0).order


def arrows(axis) -> list[np.ndarray]:
    """Return the vectors [m] from tail to tip of all arrows."""
    found = [text for text in axis.texts if isinstance(text, Annotation)]
    return [np.subtract(arrow.xy, arrow.xyann) for arrow in found]


@pytest.mark.parametrize("angle", [0.0, 0.9, 2.5, -1.4])
def test_an_arrow_is_normal_and_tangent_added_up(angle: float) -> None:
    """In axes with the normal along x the arrow is (normal, -friction)."""
    frame = ContactFrame(0.3, -0.2, np.cos(angle), np.sin(angle), friction=1.0)
    axis = Figure().subplots()
    draw_force(axis, frame, 2.0, 0.5, 0.1)
    (arrow,) = arrows(axis)
    c, s = np.cos(-angle), np.sin(-angle)
    assert np.array([[c, -s], [s, c]]) @ arrow == pytest.approx([0.2, -0.05])


def test_a_cone_opens_by_the_angle_of_friction_and_holds_the_forces_at_its_edge() -> None:
    frame = ContactFrame(1, 2, 0, 1, friction=0.75)
    cone = cone_stroke(frame, 1.0).path
    for slide in (-1, 1):
        for share, inside in ((0.99, True), (1.01, False)):
            point = np.array([1, 2]) + 0.3 * np.array([slide * share * 0.75, 1])
            assert cone.contains_point(point) is inside


def test_the_strobe_draws_every_force_to_scale_and_cones_on_request() -> None:
    figure, bare = strobe(sliding_box(NORMAL, SLIP), cones=True), strobe(sliding_box(NORMAL, SLIP))
    assert figure is not None and bare is not None
    assert not [patch for patch in bare.axes[0].patches if patch.zorder == CONE_ORDER]
    assert "cone" not in bare.axes[0].get_title("left")
    (axis,) = figure.axes
    drawn = np.array(arrows(axis))
    expected = np.stack([SLIP, NORMAL], axis=-1).reshape(-1, 2)
    expected = expected[np.hypot(*expected.T) > 0]
    scale = np.hypot(*drawn.T).max() / np.hypot(*expected.T).max()
    np.testing.assert_allclose(drawn, scale * expected, rtol=1e-12)
    cones = [patch for patch in axis.patches if patch.zorder == CONE_ORDER]
    assert len(cones) == len(expected)
    assert "4.12 N s" in axis.get_title("left") and "friction cone" in axis.get_title("left")


def test_without_stored_impulses_a_multiplier_is_a_normal_impulse() -> None:
    view = sliding_box(NORMAL, SLIP)
    bare = view.run.data.drop_vars(["normal_impulse", "friction_impulse"])
    object.__setattr__(view.run, "arrays", LabelledArrays.of(bare))
    found = forces_of(view)
    assert found is not None
    np.testing.assert_array_equal(found.normal, NORMAL)
    assert not found.friction.any()


def test_a_law_averaged_over_noise_shows_the_mean_multiplier() -> None:
    view = sliding_box(NORMAL, SLIP)
    one = view.run.data.drop_vars(["normal_impulse", "friction_impulse"])
    branches = np.concatenate([NORMAL, 3 * NORMAL], axis=1)[None]
    data = one.drop_dims("contact").assign(lam=(("scenario", "interval", "branch"), branches))
    object.__setattr__(view.run, "arrays", LabelledArrays.of(data.assign_coords(contact=["heel", "toe"])))
    found = forces_of(view)
    assert found is not None
    np.testing.assert_allclose(found.normal, 2 * NORMAL)
