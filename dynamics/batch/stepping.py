"""One step of a closed system from many states at once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import casadi as ca
import numpy as np

from dynamics.batch.arguments import (
    BLOCK,
    NonFinite,
    as_rows,
    checked_block,
    common_length,
    non_finite_rows,
)
from dynamics.batch.engines import c_steps
from dynamics.batch.engines.c_flat import CompiledEngine
from dynamics.batch.engines.choice import choose
from dynamics.batch.engines.chunk_rollout import ChunkRollout
from dynamics.batch.engines.compiler import find_compiler
from dynamics.batch.engines.kernels import KERNELS, ChunkedEngine, Kernel, NumpyKernel
from dynamics.batch.engines.parallel import checked_threads
from dynamics.batch.function import BatchFunction
from dynamics.batch.graphs.objective import free_of_cost
from dynamics.batch.graphs.policy import open_loop
from dynamics.batch.graphs.rollout_tapes import build_tapes
from dynamics.batch.graphs.tape import tape_of
from dynamics.contact import Step

CHUNK = 4096


@dataclass(frozen=True)
class Steps:
    """`x_next` (n, nx) and `lam` (n, nlam) of n samples; a step without solution is not finite."""

    x_next: np.ndarray
    lam: np.ndarray
    nonfinite: NonFinite


class StepFunction:
    """`x_next, lam = step(x, u, p)` for many samples, the contact solved as rollouts solve it.

        f = StepFunction(step)
        x_next = f(x, u).x_next        # x (n, nx), u (n, nu)

    A path that is lost is tried from other starts, fewer than those of
    :attr:`dynamics.contact.Step.solve`; where none leads to a solution the sample is not finite,
    and named by `nonfinite`. Backends, threads and block are those of `BatchFunction`; results
    depend neither on threads nor on block, to the last bit.

    Raises `ValueError` for shapes that do not fit, `UnsupportedOperation` and `CompilerError` as
    `BatchFunction` does.
    """

    def __init__(
        self, step: Step, backend: str = "auto", threads: int | None = None, block: int = BLOCK
    ) -> None:
        system = step.system
        self.threads, self.block = checked_threads(threads), checked_block(block)
        self.default_p = step.p.values
        self.tapes = build_tapes(step, free_of_cost(step), open_loop(system.nx, system.nu))
        self._derive = NumpyKernel(tape_of(self.tapes.derived))
        self.backend, self._engine = choose(backend, self._makers(), "the step")

    def _makers(self) -> dict[str, Any]:
        def compiled() -> CompiledEngine:
            text = c_steps.source(self.tapes, self.block, find_compiler())
            return CompiledEngine(self.threads, text)

        def chunked(make: Callable[[ca.Function], Kernel]) -> ChunkedEngine:
            rollout = ChunkRollout(self.tapes, make)

            def run(inputs: list[np.ndarray], outputs: list[np.ndarray]) -> None:
                x0, theta, w, p = inputs
                x, lam, cost = rollout.forward(x0, theta[None], p, w[None], outputs[0].shape[1])
                for target, value in zip(outputs, (x[1], lam[0], cost[None]), strict=True):
                    target[...] = value

            return ChunkedEngine(run, CHUNK, self.threads)

        return {"c": compiled, **{name: partial(chunked, make) for name, make in KERNELS.items()}}

    def __call__(self, x: Any, u: Any, p: Any | None = None) -> Steps:
        """Step from `x` (n, nx) under `u` (n, nu) at `p` (n, np), each also one row for all."""
        return self._stepped(*self._rows(x, u, p))

    def slopes(self, x: Any, u: Any, p: Any | None = None) -> tuple[Steps, np.ndarray, np.ndarray]:
        """The steps, and their derivatives by x (n, nx, nx) and u (n, nx, nu) at the solution."""
        given, n = self._rows(x, u, p)
        steps, nx = self._stepped(given, n), self.tapes.nx
        rows = [np.repeat(a, nx, axis=0) if len(a) > 1 else a for a in (*given, steps.lam)]
        by_x, by_u = self._adjoint(*rows, np.tile(np.eye(nx), (n, 1)))
        return steps, by_x.reshape(n, nx, nx), by_u.reshape(n, nx, -1)

    @cached_property
    def _adjoint(self) -> BatchFunction:
        return BatchFunction(self.tapes.adjoint, self.backend, self.threads, self.block)

    def _rows(self, x: Any, u: Any, p: Any | None) -> tuple[list[np.ndarray], int]:
        """Arguments of the graphs before lam, and the number of samples."""
        tapes, what = self.tapes, "the step"
        p = self.default_p if p is None else p
        given = {"x": (x, tapes.nx), "u": (u, tapes.nu), "p": (p, len(self.default_p))}
        rows = {name: as_rows(value, size, name, what) for name, (value, size) in given.items()}
        derived = np.empty((tapes.np, len(rows["p"])))
        self._derive.run([np.ascontiguousarray(rows["p"].T)], [derived])
        still = np.zeros((1, tapes.nu))
        arguments = [rows["x"], rows["u"], still, np.ascontiguousarray(derived.T)]
        return arguments, common_length(rows, what)

    def _stepped(self, given: list[np.ndarray], n: int) -> Steps:
        tapes = self.tapes
        x_next, lam, cost = outputs = [np.empty((n, size)) for size in (tapes.nx, tapes.nlam, 1)]
        bad = self._engine.evaluate(given, outputs, n) if n else 0
        found = non_finite_rows([x_next, lam, cost]) if bad else NonFinite()
        return Steps(x_next, lam, found)
