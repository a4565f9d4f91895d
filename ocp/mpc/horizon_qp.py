"""Quadratic program of a horizon, solved by an interior-point method that exploits the block structure over steps."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dynamics.batch.engines.c_program import PROXIMAL
from dynamics.batch.engines.numpy_program import NumpyProgram, ProgramSizes
from ocp.judge.constraint_rows import PENALTIES
from ocp.mpc.linearised import Affine, Linearised
from ocp.mpc.stages import StageModel

PENALTY_CURVATURE = 1e-2
"""Second derivative of the penalty of a slack, relative to the penalty's slope."""
QP_TOLERANCE = 1e-6
"""Smallest tolerance of a program's residuals, in characteristic sizes."""
GAP_TOLERANCE = 1e-7
"""Smallest tolerance of the duality gap, in characteristic costs: every sample may lose as much.

With 1e-4 and 1e-6 the loop of twenty samples that pushes the disc costs 1.3e-4 and 1e-4 of its optimum more.
"""
RESIDUAL_SHARE = 1e-2
"""Tolerance of a program's residuals relative to the linearisation error."""
MAX_LINEARISATION_ERROR = 0.1
"""Linearisation error, in characteristic sizes, above which tolerances grow no further."""
MAX_QP_ITERATIONS = 60
"""Maximum number of iterations of a program."""


class Tolerance(NamedTuple):
    """Absolute tolerances of a program: ``residual`` in characteristic sizes, duality ``gap`` in costs."""

    residual: float = QP_TOLERANCE
    gap: float = GAP_TOLERANCE

    @classmethod
    def of_error(cls, error: float) -> Tolerance:
        """Return tolerances that the next linearisation can notice, for the ``error`` of the last one.

        The error is the largest difference, in characteristic sizes, between the states that a program
        predicts and those of its rollout under the law, from which the next program is built. A program
        that is solved to a share of this error is an inexact Newton step with a forcing term by the
        disagreement of model and function (Eisenstat and Walker 1996, choice 1), so that the tolerance
        tightens as steps become small. The gap may equal the error, since the cost changes by one
        characteristic cost per characteristic size.
        """
        bounded = min(error, MAX_LINEARISATION_ERROR) if np.isfinite(error) else MAX_LINEARISATION_ERROR
        return cls(max(QP_TOLERANCE, RESIDUAL_SHARE * bounded), max(GAP_TOLERANCE, bounded))


TIGHT = Tolerance()
"""Tolerances of a program whose linearisation error is unknown."""


class Direction(NamedTuple):
    """Solution of a horizon's quadratic program: a step dx (N+1, nx), du (N, nu) of a plan, and multipliers.

    ``costates`` (N, nx) are the multipliers of the dynamics, and ``rows`` (N, n_rows) the multipliers of the
    inequality rows, in cost per characteristic size. ``violation`` is the sum of the slacks, in characteristic sizes.
    ``iterations`` is the number of iterations of the solver, which ended at ``tolerance``. ``usable`` is true for a
    solution, and for the last iterate of a solver that was stopped at its maximum number of iterations.
    """

    dx: np.ndarray
    du: np.ndarray
    costates: np.ndarray
    rows: np.ndarray
    violation: float
    solved: bool
    usable: bool
    iterations: int
    tolerance: Tolerance


class HorizonQP:
    """Quadratic program ``min sum_k 1/2 w' H w + g' w + penalty`` for a plan's step.

    The variables of step k are du_k, slacks s_k and dx_{k+1}, and w_k = (dx_k, du_{k-1}, du_k). Inequality rows and
    bounds on inputs hold up to the tolerance. Rows may be violated by s_k >= 0 at an exact penalty, so that every
    program is feasible. All rows of a step share one slack. If ``separate``, each of the model's constraints, which
    are the last rows, has its own slack, so that a constraint that cannot be satisfied does not relax the others.
    """

    def __init__(self, model: StageModel, rows: int) -> None:
        self.model = model
        self.shared, self.separate = np.zeros(rows, dtype=np.int64), np.maximum(np.arange(rows) - rows + model.m + 1, 0)
        scales = model.problem.scales
        sizes = ProgramSizes(
            model.nx, model.nu, rows, 1 + model.m, model.problem.uses_du, PROXIMAL / np.square(scales.u)
        )
        self._program = NumpyProgram(sizes)

    def solve(
        self,
        lin: Linearised,
        rows: Affine,
        dx0: np.ndarray,
        bounds: tuple[np.ndarray, np.ndarray],
        penalty: float = PENALTIES[0],
        accuracy: tuple[Tolerance, int] = (TIGHT, MAX_QP_ITERATIONS),
        *,
        separate: bool = False,
    ) -> Direction:
        """Return the step of a plan, given the measured state minus the plan's first state ``dx0`` (nx,).

        ``rows`` are constrained to 0 or above; ``bounds`` are the lower and upper bounds (N, nu) on du;
        ``penalty`` is the penalty of a slack, in characteristic costs per characteristic size; ``accuracy``
        has the tolerances, and the maximum number of iterations. The horizon may have n < N steps.
        """
        tolerance, max_iterations = accuracy
        options = float(self.model.problem.scales.cost), penalty, PENALTY_CURVATURE * penalty, *tolerance
        arrays = *lin.x_next, *rows, lin.gradient, lin.hessian, *lin.end, dx0, *bounds
        slack_of = self.separate if separate else self.shared
        solution = self._program.solve(arrays, slack_of, options, max_iterations)
        return Direction(*solution[:5], solution.status == 1, solution.status >= 0, solution.iterations, tolerance)
