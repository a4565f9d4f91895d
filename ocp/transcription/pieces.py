"""Pieces of a program with kinks: the side of every kink may be fixed, and a constraint keeps it.

Distances of corners, absolute values and maxima have kinks: ``f = f_1`` where ``a < b``, and ``f_2`` elsewhere. A
minimum at a kink has no derivative, and a solver for smooth programs does not converge to it. On a piece, where
``f = f_1`` and ``b - a >= 0``, the program is smooth (Scholtes, Introduction to Piecewise Differentiable Equations,
2012).
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, field, replace
from typing import Self

import casadi as ca
import numpy as np

from ocp.programs.layout import Layout
from ocp.programs.program import NEAR_KINK, ON_KINK
from ocp.programs.solver import Result
from ocp.transcription.kinks import FixedSides
from ocp.transcription.nlp import NLP
from ocp.transcription.stage import Stage

SIDES = "sides"
"""Block of the sides among the data, and of their constraints."""
PRESSED_MULTIPLIER = 1e-6
"""Multiplier of a kink's constraint, in natural units, above which the cost would be lower beyond the kink."""


def fix_sides(stages: list[Stage], constraints: Layout, data_start: int) -> tuple[list[Stage], int]:
    """Return stages with sides as local variables and margins as constraints, and the number of sides of all copies.

    ``data_start`` is the index of the first side in ``[x; data]``; the constraints get a block of all margins.
    """
    rewritten, number = list[tuple[Stage, list[ca.SX], FixedSides]](), 0
    for stage in stages:
        fixed = FixedSides()
        outputs = fixed.rewrite(stage.w, stage.p, [stage.cost, stage.constraints])
        rewritten.append((stage, outputs, fixed))
        number += stage.copies * len(fixed.sides)
    rows = constraints.add(SIDES, (number,)).index
    fixed_stages, first = list[Stage](), 0
    for stage, (cost, expressions), fixed in rewritten:
        count = len(fixed.sides)
        margin_rows = rows[first : first + stage.copies * count].reshape(stage.copies, count)
        first += stage.copies * count
        index = np.concatenate([stage.index, data_start + margin_rows - rows[0] if count else margin_rows], axis=1)
        fixed_stages.append(
            replace(
                stage,
                w=ca.vertcat(stage.w, *fixed.sides),
                cost=cost,
                constraints=ca.vertcat(expressions, *fixed.margins),
                index=index,
                rows=np.concatenate([stage.rows, margin_rows], axis=1),
                weight=1.0,
            )
        )
    return fixed_stages, number


@dataclass(eq=False)
class PiecewiseNLP(NLP):
    """Program whose kinks have fixed ``sides`` (number of kinks,): 1, -1, or 0 where numbers decide."""

    sides: np.ndarray = field(default_factory=lambda: np.zeros(0))

    @property
    def kink_rows(self) -> np.ndarray:
        """Indices of the margins' constraints."""
        return self.constraints[SIDES].index

    def parameter_vector(self, values: dict[str, float]) -> np.ndarray:
        """Return the vector p with the sides at its end."""
        return np.concatenate([super().parameter_vector(values), self._all_sides])

    @property
    def _all_sides(self) -> np.ndarray:
        return self.sides if self.sides.size else np.zeros(self.kink_rows.size)

    def bounds(self, values: dict[str, float]) -> dict[str, np.ndarray]:
        """Return the bounds; margins with a fixed side have its sign."""
        bounds, sides = super().bounds(values), self._all_sides
        bounds["lbg"][self.kink_rows] = np.where(sides > 0, 0.0, -np.inf)
        bounds["ubg"][self.kink_rows] = np.where(sides < 0, 0.0, np.inf)
        return bounds

    def with_sides(self, sides: np.ndarray) -> Self:
        """Return the program with other sides, which shares functions, scale and solver instances."""
        scale = self.scale
        piece = copy.copy(self)
        piece.sides = sides
        # The copy contains the scale, since it was measured before: instances of solvers depend on it.
        assert piece.scale is scale
        return piece

    def near_sides(self, x: np.ndarray, values: dict[str, float]) -> np.ndarray:
        """Return the sides at a point: 1 or -1 within ``NEAR_KINK`` changes of a kink, 0 elsewhere."""
        margins, changes = self.kink_margins(x, values)
        return np.where(np.abs(margins) < NEAR_KINK * changes, np.where(margins > 0, 1.0, -1.0), 0.0)

    def pressed(self, result: Result) -> np.ndarray:
        """Return a mask of the kinks on which a result lies, and beyond which the cost would be lower."""
        multipliers, units = result.point.lam_g, self.natural
        if multipliers is None:
            return np.zeros(self.kink_rows.size, dtype=bool)
        margins = result.g[self.kink_rows] / units.g[self.kink_rows]
        presses = np.abs(multipliers[self.kink_rows]) * units.g[self.kink_rows] / units.f
        return (self.sides != 0) & (np.abs(margins) < ON_KINK) & (presses > PRESSED_MULTIPLIER)
