"""Compiled solver of a horizon's quadratic program alone, which a controller calls within its sample."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence

import numpy as np

from dynamics.batch.engines.c_flat import data_address, data_addresses
from dynamics.batch.engines.c_program import program_source
from dynamics.batch.engines.compiler import load_library
from dynamics.batch.engines.numpy_program import ProgramSizes, ProgramSolution
from ocp.mpc.horizon_qp import HorizonQP
from ocp.mpc.stages import StageModel


def compiled_qp(model: StageModel, rows: int) -> HorizonQP:
    """Return the quadratic program of a horizon with the compiled solver."""
    qp = HorizonQP(model, rows)
    qp._program = CompiledProgram(qp._program.sizes, model.N)  # pyright: ignore[reportAttributeAccessIssue]
    return qp


class CompiledProgram:
    """Compiled solver of a horizon's quadratic program, by Mehrotra's method with a Riccati recursion.

    The constructor raises :class:`~dynamics.batch.engines.compiler.CompilerError` without a C compiler.
    """

    def __init__(self, sizes: ProgramSizes, N: int) -> None:
        library = load_library(program_source(*sizes[:5]), ["solve_program"], level=3)
        library.stage_bytes.restype = library.solve_program.restype = ctypes.c_int64
        library.solve_program.argtypes = 5 * [ctypes.c_void_p]
        self.sizes, self._solve, self._proximal = sizes, library.solve_program, sizes.proximal
        self._work = np.empty((N + 1) * library.stage_bytes() // 8)

    def solve(
        self, arrays: Sequence[np.ndarray], slack_of: np.ndarray, options: Sequence[float], max_iterations: int
    ) -> ProgramSolution:
        """Solve a program of any number of steps up to that of the constructor; see :class:`NumpyProgram`."""
        nx, nu, rows = self.sizes[:3]
        N = len(arrays[0])
        dx, du, costates, multipliers, counted = (
            np.empty(shape) for shape in ((N + 1, nx), (N, nu), (N, nx), (N, rows), 2)
        )
        outputs = [dx, du, costates, multipliers, counted]
        inputs = [np.ascontiguousarray(array) for array in arrays]
        counts = np.array([N, max_iterations, slack_of.max(initial=0) + 1, *slack_of])
        settings = np.array([*options, *self._proximal])
        pointers = data_address(counts), data_address(settings), data_addresses(inputs), data_addresses(outputs)
        status = self._solve(data_address(self._work), *pointers)
        return ProgramSolution(dx, du, costates, multipliers, float(counted[0]), int(counted[1]), status)
