"""Plans of a receding-horizon controller, drawn as pale shapes behind the bodies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from problems.drawing import Shape
from problems.spec import ProblemSpec
from reports.drawing.view import RunView


def plan_shapes(view: RunView, sample: int, node: int, body: Sequence[Shape]) -> list[Shape]:
    """Return the shapes at a node of a sample's plan (seed 0), except shapes that are also in ``body``.

    The list is empty if the problem has no drawing, or the sample has no plan.
    """
    spec, plan = view.spec, view.array("plan")
    if not isinstance(spec, ProblemSpec) or spec.draw is None or plan is None:
        return []
    state = plan[0, min(sample, plan.shape[1] - 1), node]
    if not np.isfinite(state).all():
        return []
    return [replace(shape, role="plan") for shape in spec.draw(view.params, state) if shape not in body]


def with_ghosts(view: RunView, times: np.ndarray, shapes: Sequence[list[Shape]]) -> list[list[Shape]]:
    """Return the shapes of each frame at ``times`` [s], preceded by the shapes at the end of the sample's plan."""
    samples = np.searchsorted(view.time, times + 1e-9 * view.time[-1], side="right") - 1
    return [[*plan_shapes(view, int(sample), -1, body), *body] for sample, body in zip(samples, shapes, strict=False)]
