"""Evaluation of any CasADi function, or of one step through contact, for an array of samples."""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import casadi as ca
import numpy as np

from dynamics.batch.arguments import (
    DEFAULT_BLOCK,
    BatchWarning,
    NonFinite,
    as_output,
    as_rows,
    bind_arguments,
    common_length,
    non_finite_rows,
)
from dynamics.batch.engines import c_flat, c_steps
from dynamics.batch.engines.c_flat import CompiledEngine
from dynamics.batch.engines.chunk_rollout import PYTHON_CHUNK, ChunkRollout
from dynamics.batch.engines.compiler import find_compiler
from dynamics.batch.engines.kernels import (
    KERNEL_MAKERS,
    CasadiKernel,
    ChunkedEngine,
    Kernel,
    NumpyKernel,
    ParameterKernel,
    choose_backend,
    chunk_length,
)
from dynamics.batch.engines.parallel import checked_threads
from dynamics.batch.graphs.objective import free_of_cost
from dynamics.batch.graphs.policy import open_loop
from dynamics.batch.graphs.rollout_tapes import ClosedStep
from dynamics.batch.graphs.tape import Tape, UnsupportedOperation, tape_of
from dynamics.contact import Step
from dynamics.settings import read_count

# Number of samples in a chunk that CasADi's virtual machine evaluates.
CASADI_CHUNK = 1024
MAX_COMPILED_OPERATIONS = 40_000
"""Number of operations above which `auto` does not compile: compilers need minutes for longer programs."""


class BatchFunction:
    """Evaluation of any CasADi `Function` for an array of samples.

        f = BatchFunction(ca.Function("f", [x, p], [y], ["x", "p"], ["y"]))
        y = f(x, p)            # x (n_samples, nnz_x), p (n_samples, nnz_p) or (nnz_p,) for all
        y = f(x=x, p=p)["y"]   # by name: a dictionary of outputs

    Rows hold nonzeros in CasADi's order. Outputs are `(n_samples, nnz_out)`: one array, or a tuple if the function
    has several. `backend` is `c`, `numpy`, `casadi`, or `auto` for the fastest that can be built on this computer.
    `threads` is None for all CPUs. `block` is the number of samples that a kernel works on at once. Results do not
    depend on `threads` or `block`, to the last bit.

    After a call `nonfinite` lists the samples with NaN or infinity, and a `BatchWarning` reports them.

    Raises `ValueError` for an unknown backend, wrong shapes or counts; `UnsupportedOperation` if
    the named backend lacks an operation; `CompilerError` if `c` is unavailable.
    """

    def __init__(
        self,
        fn: ca.Function,
        backend: str = "auto",
        threads: int | None = None,
        block: int = DEFAULT_BLOCK,
    ) -> None:
        self.name = fn.name()
        self.input_names = tuple(fn.name_in())
        self.output_names = tuple(fn.name_out())
        self.input_sizes = tuple(fn.nnz_in(k) for k in range(fn.n_in()))
        self.output_sizes = tuple(fn.nnz_out(k) for k in range(fn.n_out()))
        self.threads = checked_threads(threads)
        self.block = read_count("block", block)
        self.nonfinite = NonFinite()
        self.backend, self._engine = choose_backend(backend, self._makers(fn, backend), f"'{self.name}'")

    def _makers(self, fn: ca.Function, backend: str) -> dict[str, Any]:
        tape = functools.cache(lambda: tape_of(fn))

        def by_numpy() -> ChunkedEngine:
            kernel = NumpyKernel(tape())
            chunk = chunk_length(kernel.width, self.block)
            return ChunkedEngine(kernel.run, chunk, self.threads)

        def compiled() -> c_flat.CompiledEngine:
            text = c_flat.batch_source(tape(), self.block, find_compiler())
            return c_flat.CompiledEngine(self.threads, text)

        interpreted = {
            "numpy": by_numpy,
            "casadi": lambda: ChunkedEngine(CasadiKernel(fn, self.threads).run, CASADI_CHUNK, 1),
        }
        is_too_long = backend == "auto" and _too_long(tape)
        return interpreted if is_too_long else {"c": compiled, **interpreted}

    @property
    def compiled(self) -> CompiledEngine | None:
        """Compiled engine, or None for another backend."""
        return self._engine if isinstance(self._engine, CompiledEngine) else None

    def __call__(self, *args: Any, out: Sequence[np.ndarray] | None = None, **named: Any) -> Any:
        """Evaluate the function; `out` may give arrays `(n_samples, nnz_out)` to write to, one for each output."""
        values = bind_arguments(args, named, self.input_names, f"'{self.name}'")
        rows = [
            as_rows(value, size, name, f"'{self.name}'")
            for value, size, name in zip(values, self.input_sizes, self.input_names, strict=True)
        ]
        n = common_length(dict(zip(self.input_names, rows, strict=True)), f"'{self.name}'")
        outputs = self._outputs(out, n)
        n_bad = self._engine.evaluate(rows, outputs, n) if n else 0
        self.nonfinite = non_finite_rows(outputs) if n_bad else NonFinite()
        if self.nonfinite:
            warnings.warn(f"'{self.name}': {self.nonfinite}", BatchWarning, stacklevel=2)
        if named:
            return dict(zip(self.output_names, outputs, strict=True))
        return outputs[0] if len(outputs) == 1 else tuple(outputs)

    def _outputs(self, out: Sequence[np.ndarray] | None, n: int) -> list[np.ndarray]:
        arrays = [None] * len(self.output_sizes) if out is None else list(out)
        if len(arrays) != len(self.output_sizes):
            raise ValueError(
                f"'{self.name}' has {len(self.output_sizes)} outputs "
                f"({', '.join(self.output_names)}), but out holds {len(arrays)} arrays"
            )
        return [
            as_output(array, (n, size), name)
            for array, size, name in zip(arrays, self.output_sizes, self.output_names, strict=True)
        ]


def _too_long(tape: Callable[[], Tape]) -> bool:
    try:
        return len(tape().operations) > MAX_COMPILED_OPERATIONS
    except UnsupportedOperation:
        return False


@dataclass(frozen=True)
class Steps:
    """Next states (n, nx) and contact multipliers (n, nlam) of n samples, not finite for a step without solution."""

    x_next: np.ndarray
    lam: np.ndarray
    nonfinite: NonFinite


class StepFunction:
    """Evaluation of `x_next, lam = step(x, u, p)` for many samples, with the contact solver of rollouts.

        f = StepFunction(step)
        x_next = f(x, u).x_next        # x (n, nx), u (n, nu)

    If the interior-point path fails, it is followed again from other starts, fewer of them than in
    :attr:`dynamics.contact.Step.solve`; a sample without a solution is not finite, and `nonfinite` lists it.
    Backends, threads and block are those of `BatchFunction`; results depend neither on threads nor on block, to
    the last bit.

    Raises `ValueError` for shapes that do not fit, `UnsupportedOperation` and `CompilerError` as
    `BatchFunction` does.
    """

    def __init__(
        self, step: Step, backend: str = "auto", threads: int | None = None, block: int = DEFAULT_BLOCK
    ) -> None:
        system = step.system
        self.threads, self.block = checked_threads(threads), read_count("block", block)
        self.default_p = step.p.values
        self._closed_step = ClosedStep(step, free_of_cost(step), open_loop(system.nx, system.nu))
        self.tapes = self._closed_step.tapes
        self._derive = ParameterKernel(self.tapes.derived)
        self.backend, self._engine = choose_backend(backend, self._makers(), "the step")

    def _makers(self) -> dict[str, Any]:
        def compiled() -> CompiledEngine:
            text = c_steps.step_source(self.tapes, self.block, find_compiler())
            return CompiledEngine(self.threads, text)

        def chunked(make: Callable[[ca.Function], Kernel]) -> ChunkedEngine:
            rollout = ChunkRollout(self.tapes, make)

            def run(inputs: list[np.ndarray], outputs: list[np.ndarray]) -> None:
                x0, theta, w, p = inputs
                x, lam, cost = rollout.forward(x0, theta[None], p, w[None], outputs[0].shape[1])
                for target, value in zip(outputs, (x[1], lam[0], cost[None]), strict=True):
                    target[...] = value

            return ChunkedEngine(run, PYTHON_CHUNK, self.threads)

        return {"c": compiled, **{name: partial(chunked, make) for name, make in KERNEL_MAKERS.items()}}

    def __call__(self, x: Any, u: Any, p: Any | None = None) -> Steps:
        """Return the steps from `x` (n, nx) under `u` (n, nu) with `p` (n, np); arrays of one row are shared."""
        return self._evaluate(*self._rows(self._derive, x, u, p))

    def derivatives(self, x: Any, u: Any, p: Any | None = None) -> tuple[Steps, np.ndarray, np.ndarray]:
        """Return the steps and the derivatives of x_next with respect to x (n, nx, nx) and u (n, nx, nu)."""
        steps, nx = self(x, u, p), self.tapes.nx
        arguments, n = self._rows(self._derive_for_adjoint, x, u, p)
        rows = [np.repeat(a, nx, axis=0) if len(a) > 1 else a for a in (*arguments, steps.lam)]
        by_x, by_u = self._adjoint(*rows, np.tile(np.eye(nx), (n, 1)))
        return steps, by_x.reshape(n, nx, nx), by_u.reshape(n, nx, -1)

    @cached_property
    def _derive_for_adjoint(self) -> ParameterKernel:
        return ParameterKernel(self._closed_step.tapes_with_adjoint.derived)

    @cached_property
    def _adjoint(self) -> BatchFunction:
        adjoint = self._closed_step.tapes_with_adjoint.adjoint
        assert adjoint is not None
        return BatchFunction(adjoint.step, self.backend, self.threads, self.block)

    def _rows(self, derive: ParameterKernel, x: Any, u: Any, p: Any | None) -> tuple[list[np.ndarray], int]:
        """Return the arguments (x, u, noise, derived parameters) of graphs, and the number of samples."""
        tapes, owner = self.tapes, "the step"
        p = self.default_p if p is None else p
        inputs = {"x": (x, tapes.nx), "u": (u, tapes.nu), "p": (p, len(self.default_p))}
        rows = {name: as_rows(value, size, name, owner) for name, (value, size) in inputs.items()}
        no_noise = np.zeros((1, tapes.nu))
        arguments = [rows["x"], rows["u"], no_noise, derive(rows["p"])]
        return arguments, common_length(rows, owner)

    def _evaluate(self, arguments: list[np.ndarray], n: int) -> Steps:
        tapes = self.tapes
        x_next, lam, cost = outputs = [np.empty((n, size)) for size in (tapes.nx, tapes.nlam, 1)]
        n_bad = self._engine.evaluate(arguments, outputs, n) if n else 0
        nonfinite = non_finite_rows([x_next, lam, cost]) if n_bad else NonFinite()
        return Steps(x_next, lam, nonfinite)
