"""Characteristic sizes of machines at rest."""

from __future__ import annotations

import numpy as np
import pytest

from ocp.problem.sizes import derive_sizes
from problems.registry import spec


def test_what_rests_on_the_ground_has_sizes_of_its_joints() -> None:
    """The machine does not move; its lengths follow from the change of gaps as joints turn."""
    problem = spec("examples/push_up.py").problem()
    sizes = derive_sizes(problem)
    assert sizes.x[2] == pytest.approx(0.5)  # distance to the goal
    assert np.all(sizes.x[:2] > 0.01) and np.all(sizes.x[4:6] > 0.01)
