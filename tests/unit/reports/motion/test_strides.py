"""A stride that is drawn several times continues where it ended."""

from __future__ import annotations

import numpy as np
import pytest

from reports.drawing.strobe import strobe
from reports.motion.animation import Animation, is_periodic, repeated
from tests.unit.reports.made import sliding_box

PUSHES = np.array([[1.0, 2.0], [3.0, 0.0]])


def test_states_and_time_go_on_and_impulses_come_back() -> None:
    twice = repeated(sliding_box(PUSHES, PUSHES / 2, x=np.array([0.0, 0.4, 0.5])), 2)
    assert twice.array("x")[0, :, 0] == pytest.approx([0.0, 0.4, 0.5, 0.9, 1.0])
    assert twice.time == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4])
    assert twice.array("normal_impulse")[0] == pytest.approx(np.concatenate([PUSHES, PUSHES]))
    assert twice.title == "A box that slides, the stride 2 times"
    assert Animation(twice).times[-1] == pytest.approx(0.4)


def test_a_problem_that_does_not_say_so_is_not_periodic() -> None:
    assert not is_periodic(sliding_box(PUSHES, PUSHES))


@pytest.mark.parametrize(("way", "instants"), [(0.0, 3), (0.1, 4), (2.0, 7)])
def test_a_strobe_shows_few_instants_of_what_hardly_moves(way: float, instants: int) -> None:
    """The box moves by 0.1 m, a quarter of its width, which adds one instant to three."""
    normal = np.zeros((20, 2))
    figure = strobe(sliding_box(normal, normal, x=way * np.linspace(0, 1, 21)))
    assert figure is not None
    boxes = [patch for patch in figure.axes[0].patches if len(patch.get_path().vertices) > 6]
    assert len(boxes) == (instants if way else 1)
