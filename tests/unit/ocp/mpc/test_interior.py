"""The interior-point method agrees with its NumPy version and with PIQP, which is another algorithm."""

from __future__ import annotations

from typing import Any

import numpy as np
import piqp
import pytest

from dynamics.batch.engines.numpy_program import NumpyProgram, ProgramSizes
from ocp.mpc.controller import Controller
from ocp.mpc.horizon_qp import MAX_QP_ITERATIONS, Direction, HorizonQP, Tolerance
from problems import get
from tests.benchmarks.mpc.compiled_program import CompiledProgram, compiled_qp
from tests.benchmarks.mpc.programs import Program, by_piqp

TIGHTER = Tolerance(1e-8, 1e-8)


def programs_of(name: str, samples: int, monkeypatch: pytest.MonkeyPatch) -> tuple[Controller, list[tuple[Any, ...]]]:
    """Return a controller and the arguments of its programs in a loop with a disturbed state."""
    seen, solve = [], HorizonQP.solve

    def keep(self: HorizonQP, *arguments: Any, **separate: bool) -> Direction:
        seen.append(arguments[:5])
        return solve(self, *arguments, **separate)

    controller, rng = Controller(get(name)), np.random.default_rng(0)
    controller._phase.compiled = None
    monkeypatch.setattr(HorizonQP, "solve", keep)
    x = controller.start
    for _ in range(samples):
        plan = controller.step(x).plan
        assert plan is not None
        x = plan.x[1] + 0.01 * controller.problem.scales.x * rng.standard_normal(x.size)
    monkeypatch.undo()
    return controller, seen[-samples:]


@pytest.mark.costly
@pytest.mark.parametrize("separate", [False, True])
@pytest.mark.parametrize("name", ["soft-walls", "finger-disc", "planar-push"])
def test_compiled_iterations_equal_those_in_numpy(name: str, separate: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Iterates agree up to rounding, which the curvature of constraints near their bounds amplifies."""
    controller, programs = programs_of(name, 3, monkeypatch)
    compiled = compiled_qp(controller.model, len(programs[0][1].value[0]))
    interpreted = HorizonQP(controller.model, len(programs[0][1].value[0]))
    for arguments in programs:
        found, expected = (
            qp.solve(*arguments, (Tolerance(), MAX_QP_ITERATIONS), separate=separate) for qp in (compiled, interpreted)
        )
        assert found.solved and (found.iterations, found.solved) == (expected.iterations, expected.solved)
        for first, second in zip(found[:5], expected[:5], strict=True):
            assert np.max(np.abs(first - second), initial=0.0) <= 1e-9 * (1 + np.max(np.abs(second), initial=0.0))


@pytest.mark.costly
@pytest.mark.parametrize("name", ["soft-walls", "spinner", "planar-push"])
def test_solutions_are_those_of_another_solver(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Values differ by the gap, and inputs by its root over the curvature."""
    controller, programs = programs_of(name, 3, monkeypatch)
    sizes = controller.problem.scales
    qp = compiled_qp(controller.model, len(programs[0][1].value[0]))
    for arguments in programs:
        program = Program.of(*arguments)
        z = by_piqp(program, piqp.KKTSolver.sparse_ldlt, 1e-10, True)()
        found = qp.solve(*arguments, (TIGHTER, MAX_QP_ITERATIONS))
        assert found.solved
        expected = z.reshape(controller.model.N, -1)
        mixed = np.concatenate([found.du, expected[:, found.du.shape[1] : -found.dx.shape[1]], found.dx[1:]], axis=1)
        value, best = (0.5 * v @ (program.P @ v) + program.c @ v for v in (mixed.ravel(), z))
        assert value == pytest.approx(best, abs=1e-6 * sizes.cost + 1e-6 * abs(best))
        assert abs((found.du - expected[:, : found.du.shape[1]]) / sizes.u).max() < 1e-3


def test_bounds_multipliers_and_slacks_have_their_closed_form() -> None:
    """One step of x' = u with the cost (u - 3)^2 / 2, the bound u <= 2 and the row 1 - u >= 0 at a penalty p.

    Without the row u = 2. With it 3 - u = z on the row while z <= p, so that u = 1 for p >= 2; for p = 1 the row
    gives way up to the slack s = u - 1 with 3 - u = p + c s.
    """
    sizes = ProgramSizes(1, 1, 1, 1, False, np.array([1e-10]))
    one, zero = np.ones((1, 1)), np.zeros((1, 1))
    hessian = np.zeros((1, 3, 3))
    hessian[0, 2, 2] = 1.0
    model = zero, zero[None], one[None], one, zero[None], -one[None], np.array([[0.0, 0.0, -3.0]]), hessian
    arrays = *model, np.zeros(1), zero, np.zeros(1), -np.full((1, 1), np.inf), 2 * one
    for penalty, curvature in ((100.0, 1.0), (1.0, 0.5), (0.1, 0.0)):
        u = max(1.0, min(2.0, (3 - penalty + curvature) / (1 + curvature)))
        for method in (CompiledProgram(sizes, 1), NumpyProgram(sizes)):
            options = 1.0, penalty, curvature, 1e-9, 1e-9
            found = method.solve(arrays, np.zeros(1, dtype=np.int64), options, 50)
            assert found.status == 1
            assert found.du[0, 0] == pytest.approx(u, abs=1e-6)
            assert found.dx[1, 0] == pytest.approx(u, abs=1e-6)
            assert found.violation == pytest.approx(u - 1, abs=1e-6)
            if u < 2:
                assert found.rows[0, 0] == pytest.approx(3 - u, abs=1e-6)


def test_values_that_are_not_finite_are_no_solution() -> None:
    sizes = ProgramSizes(1, 1, 0, 1, False, np.array([1e-10]))
    nan, zero, none = np.full((1, 1), np.nan), np.zeros((1, 1)), np.zeros((1, 0))
    rows = none, np.zeros((1, 0, 1)), np.zeros((1, 0, 1))
    arrays = nan, zero[None], zero[None], *rows, np.zeros((1, 3)), np.zeros((1, 3, 3)), np.zeros(1), zero, np.zeros(1)
    free = np.full((1, 1), np.inf)
    for method in (CompiledProgram(sizes, 1), NumpyProgram(sizes)):
        found = method.solve((*arrays, -free, free), np.zeros(0, dtype=np.int64), (1.0, 1.0, 0.0, 1e-6, 1e-6), 5)
        assert (found.status, found.iterations) == (-1, 0)
