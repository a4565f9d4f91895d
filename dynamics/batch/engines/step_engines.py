"""Backends of one step of many samples: compiled, or in Python over chunks."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np

from dynamics.batch.engines import c_steps, compiler
from dynamics.batch.engines.c_flat import CompiledEngine, driver
from dynamics.batch.engines.c_prelude import prelude
from dynamics.batch.engines.c_rollout import LONG, UNROLLED
from dynamics.batch.engines.chunk_rollout import ChunkRollout, Kernel
from dynamics.batch.engines.compiler import Compiler
from dynamics.batch.engines.parallel import over_chunks, transpose
from dynamics.batch.graphs.step_graphs import RolloutTapes

CHUNK = 4096
_GIVEN = ("U",) * 4
_STRIDES = {
    "step": (_GIVEN, ("U",) * 3),
    "opening": (_GIVEN, ("A", "A")),
    "closing": ((*_GIVEN, "A"), ("U",) * 3),
}


def c_step_engine(tapes: RolloutTapes, threads: int, block: int) -> CompiledEngine:
    """The engine of backend `c`. Raises `CompilerError` where the step cannot be compiled."""
    text = source(tapes, block, compiler.find_compiler())
    return CompiledEngine("c", threads, compiler.load(text, ["run"]).run)


def source(tapes: RolloutTapes, block: int, machine: Compiler) -> str:
    """The C text of one step of many samples, on blocks of about `block`."""
    functions = c_steps.graphs(tapes)
    length = sum(fn.n_instructions() for fn in functions.values())
    abreast = 2 if UNROLLED < length <= LONG else 1
    registers = {"U": abreast * max(1, block // (abreast * machine.width))}
    return "".join(
        (
            prelude(machine),
            c_steps.constants(tapes, abreast, registers),
            *c_steps.kernels(tapes, functions, abreast, _STRIDES),
            c_steps.one_step(tapes, with_ts=False),
            "#define kernel one_step\n",
            driver((tapes.nx, tapes.n_theta, tapes.nu, tapes.np), (tapes.nx, tapes.nlam, 1)),
        )
    )


class ChunkStepEngine:
    """One step by kernels that `make` builds of graphs, over chunks of samples."""

    def __init__(
        self, tapes: RolloutTapes, threads: int, make: Callable[[ca.Function], Kernel]
    ) -> None:
        self._threads = threads
        self._rollout = ChunkRollout(tapes, 1, True, make)

    def evaluate(self, inputs: list[np.ndarray], outputs: list[np.ndarray], n: int) -> int:
        """Fill `outputs` for all n samples; returns how many of them are not finite."""
        bad: list[int] = []

        def work(begin: int, end: int) -> None:
            rows = [a[begin:end] if len(a) > 1 else a for a in inputs]
            named = zip(("x0", "theta", "w", "p"), rows, strict=True)
            x0, theta, w, p = (self._rollout.scratch.columns(name, a) for name, a in named)
            x, lam, cost = self._rollout.forward(x0, theta[None], p, w[None], end - begin)
            values = (x[1], lam[0], cost[None])
            for target, value in zip(outputs, values, strict=True):
                transpose(value.T, target[begin:end])
            total = sum(value.sum(axis=0) for value in values)
            bad.append(end - begin - int(np.count_nonzero(np.isfinite(total))))

        over_chunks(n, CHUNK, self._threads, work)
        return sum(bad)
