"""Runs of IPOPT end once their steps stay short, and are not changed before."""

from __future__ import annotations

import signal
from typing import Any

import casadi as ca
import numpy as np
import pytest

from ocp.mpcc.programs import MPCC, programs_of
from ocp.programs import options as solver_options
from ocp.programs.options import ABANDONS, MAX_SHORT_STEPS, SHORT_STEP
from ocp.programs.program import PENALTY, RELAXATION
from ocp.programs.solver import Point, Result, Solver, Status

START = np.array([-4.0, 1.0, 1.0])
"""Start from which Newton steps end at bounds: a feasible point has x0 >= 1 (Wächter and Biegler 2000)."""


def stuck_program() -> Any:
    """Return ``min x0`` subject to ``x1 = x0² - 1``, ``x2 = x0 - 1/2`` and ``x1, x2 >= 0``."""
    x = ca.SX.sym("x", 3)
    g = ca.vertcat(x[0] ** 2 - x[1] - 1, x[0] - x[2] - 0.5)
    empty = ca.SX(0, 1)
    mpcc = MPCC(x, x[0], empty, empty, g=g, lbx=[-np.inf, 0.0, 0.0])
    return programs_of(mpcc, np.zeros(0), START)("none")


def run(**options: Any) -> tuple[Result, np.ndarray]:
    """Return the result of a run from the start, and its step lengths after the first iterate."""
    program, solver = stuck_program(), Solver()
    values = {PENALTY: 0.0, RELAXATION: 0.0}
    result = solver.run(program, Point(START), program.parameter_vector(values), program.bounds(values), **options)
    function, _ = next(iter(program.solvers.values()))
    return result, np.array(function.stats()["iterations"]["alpha_pr"])


def first_end(steps: np.ndarray, count: int) -> int:
    """Return the first number of iterates, a multiple of 8, the last ``count`` of which ended short steps; -1 if none.

    The first entry of ``steps`` belongs to the start, which the monitor sees as well.
    """
    ends = range(8, steps.size + 1, 8)
    return next((end for end in ends if end >= count and (steps[end - count : end] < SHORT_STEP).all()), -1)


def test_a_run_ends_after_short_steps_in_a_row(monkeypatch: pytest.MonkeyPatch) -> None:
    """The end follows from the history of the run without a limit, whose first iterates are the same."""
    whole, steps = run()
    monkeypatch.setattr(solver_options, "MAX_SHORT_STEPS", 8)
    ended, shorter = run(**{ABANDONS: True})
    end = first_end(steps, 8)
    assert 0 < end < whole.iterations
    assert shorter.size == end
    np.testing.assert_array_equal(shorter, steps[:end])
    assert ended.word == "Short_Steps" and ended.status is Status.FAILED


def test_a_run_with_few_short_steps_is_not_changed() -> None:
    """The steps stay short for fewer iterations than the limit, and every bit of the result is the same."""
    whole, steps = run()
    ended, same_steps = run(**{ABANDONS: True})
    assert first_end(steps, MAX_SHORT_STEPS) == -1
    np.testing.assert_array_equal(same_steps, steps)
    np.testing.assert_array_equal(ended.point.x, whole.point.x)
    assert ended.word == whole.word == "Infeasible_Problem_Detected"


def test_ctrl_c_within_the_monitor_ends_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(*_: Any) -> list[int]:
        signal.raise_signal(signal.SIGINT)
        return [0]

    monkeypatch.setattr(solver_options.ShortSteps, "eval", interrupt)
    with pytest.raises(KeyboardInterrupt):
        run(**{ABANDONS: True})
