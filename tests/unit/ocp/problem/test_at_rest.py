"""Sizes of machines that stand still."""

from __future__ import annotations

import numpy as np
import pytest

from ocp.problem.sizes import derive_sizes
from problems.registry import spec


def test_what_rests_on_the_ground_has_sizes_of_its_joints() -> None:
    """Only a solver's error moves; lengths follow from what gaps change by as joints turn."""
    problem = spec("examples/push_up.py").problem()
    sizes = derive_sizes(problem)
    assert sizes.x[2] == pytest.approx(0.5)  # the goal
    assert np.all(sizes.x[:2] > 0.01) and np.all(sizes.x[4:6] > 0.01)
