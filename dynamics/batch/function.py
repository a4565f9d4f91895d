"""Batched evaluation of any CasADi function over an array of samples."""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable, Sequence
from typing import Any

import casadi as ca
import numpy as np

from dynamics.batch.arguments import (
    BLOCK,
    BatchWarning,
    NonFinite,
    as_output,
    as_rows,
    bind,
    checked_block,
    common_length,
    non_finite_rows,
)
from dynamics.batch.engines import c_flat
from dynamics.batch.engines.choice import choose
from dynamics.batch.engines.compiler import find_compiler
from dynamics.batch.engines.kernels import CasadiKernel, ChunkedEngine, NumpyKernel, chunk_length
from dynamics.batch.engines.parallel import checked_threads
from dynamics.batch.graphs.tape import Tape, UnsupportedOperation, tape_of

CASADI_CHUNK = 1024
LONGEST = 40_000
"""Operations beyond which `auto` interprets: compilers take minutes over longer programs."""


class BatchFunction:
    """Any CasADi `Function` over an array of samples.

        f = BatchFunction(ca.Function("f", [x, p], [y], ["x", "p"], ["y"]))
        y = f(x, p)            # x (n_samples, nnz_x), p (n_samples, nnz_p) or (nnz_p,) for all
        y = f(x=x, p=p)["y"]   # by name: a dictionary of outputs

    Rows hold nonzeros in CasADi's order. Outputs are `(n_samples, nnz_out)`: one array, or a tuple
    where the function has several. `backend` is `c`, `numpy`, `casadi`, or `auto` for the fastest
    that can be built here. `threads` is None for every CPU. `block` is how many samples are worked
    on at once. Results do not depend on `threads` or `block`, to the last bit.

    After a call `nonfinite` holds the samples with NaN or infinity; a `BatchWarning` does too.

    Raises `ValueError` for an unknown backend, wrong shapes or counts; `UnsupportedOperation` where
    the named backend lacks an operation; `CompilerError` where `c` is unavailable.
    """

    def __init__(
        self,
        fn: ca.Function,
        backend: str = "auto",
        threads: int | None = None,
        block: int = BLOCK,
    ) -> None:
        self.name = fn.name()
        self.input_names = tuple(fn.name_in())
        self.output_names = tuple(fn.name_out())
        self.input_sizes = tuple(fn.nnz_in(k) for k in range(fn.n_in()))
        self.output_sizes = tuple(fn.nnz_out(k) for k in range(fn.n_out()))
        self.threads = checked_threads(threads)
        self.block = checked_block(block)
        self.nonfinite = NonFinite()
        self.backend, self._engine = choose(backend, self._makers(fn, backend), f"'{self.name}'")

    def _makers(self, fn: ca.Function, backend: str) -> dict[str, Any]:
        tape = functools.cache(lambda: tape_of(fn))

        def by_numpy() -> ChunkedEngine:
            kernel = NumpyKernel(tape())
            chunk = chunk_length(kernel.width, self.block)
            return ChunkedEngine(kernel.run, chunk, self.threads)

        def compiled() -> c_flat.CompiledEngine:
            text = c_flat.source(tape(), self.block, find_compiler())
            return c_flat.CompiledEngine(self.threads, text)

        interpreted = {
            "numpy": by_numpy,
            "casadi": lambda: ChunkedEngine(CasadiKernel(fn, self.threads).run, CASADI_CHUNK, 1),
        }
        long = backend == "auto" and _too_long(tape)
        return interpreted if long else {"c": compiled, **interpreted}

    def __call__(self, *args: Any, out: Sequence[np.ndarray] | None = None, **named: Any) -> Any:
        """Evaluate; `out` gives arrays `(n_samples, nnz_out)` to write to, one for each output."""
        values = bind(args, named, self.input_names, f"'{self.name}'")
        rows = [
            as_rows(value, size, name, f"'{self.name}'")
            for value, size, name in zip(values, self.input_sizes, self.input_names, strict=True)
        ]
        n = common_length(dict(zip(self.input_names, rows, strict=True)), f"'{self.name}'")
        outputs = self._outputs(out, n)
        bad = self._engine.evaluate(rows, outputs, n) if n else 0
        self.nonfinite = non_finite_rows(outputs) if bad else NonFinite()
        if self.nonfinite:
            warnings.warn(f"'{self.name}': {self.nonfinite}", BatchWarning, stacklevel=2)
        if named:
            return dict(zip(self.output_names, outputs, strict=True))
        return outputs[0] if len(outputs) == 1 else tuple(outputs)

    def _outputs(self, out: Sequence[np.ndarray] | None, n: int) -> list[np.ndarray]:
        given = [None] * len(self.output_sizes) if out is None else list(out)
        if len(given) != len(self.output_sizes):
            raise ValueError(
                f"'{self.name}' has {len(self.output_sizes)} outputs "
                f"({', '.join(self.output_names)}), but out holds {len(given)} arrays"
            )
        return [
            as_output(array, (n, size), name)
            for array, size, name in zip(given, self.output_sizes, self.output_names, strict=True)
        ]


def _too_long(tape: Callable[[], Tape]) -> bool:
    try:
        return len(tape().operations) > LONGEST
    except UnsupportedOperation:
        return False
