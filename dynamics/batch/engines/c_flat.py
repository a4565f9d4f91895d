"""C backend of a batched function: a kernel made from its tape, and a loop over blocks of samples."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence

import numpy as np

from dynamics.batch.engines import c_source, compiler
from dynamics.batch.engines.c_prelude import vector_prelude
from dynamics.batch.engines.c_source import RegisterLayout
from dynamics.batch.engines.compiler import Compiler
from dynamics.batch.engines.parallel import run_chunks
from dynamics.batch.graphs.tape import Tape

# Number of samples that a thread takes at once.
THREAD_CHUNK = 1024
# SIMD registers of samples that a kernel works on at once: a graph unrolled over time is one chain of
# dependent operations, and several such chains keep the processor busy.
ABREAST = 4
# Number of these registers for long graphs, whose compilation would take too long with more.
ABREAST_IN_LONG_GRAPHS = 2
# Number of operations above which a graph counts as long.
LONG_GRAPH = 2500
# Number of characters of C text above which compilers take minutes at the second level of optimisation.
LONG_TEXT = 1 << 21
# Maximum number of operations of one C function. It is smaller than elsewhere, since each operation becomes
# `ABREAST` statements.
PART = 500

_DRIVER = """\
static i64 evaluate(i64 begin, i64 end, const double *const *a, const i64 *shared,
                    double *const *b) {
  static const i64 nx[] = {%(input_sizes)s}, ny[] = {%(output_sizes)s};
  V *memory = aligned_alloc(sizeof(V), sizeof(V) * (U * (%(nx)d + %(ny)d) + 1));
  if (!memory) return -1;
  V *x[%(n_in)d + 1], *y[%(n_out)d + 1], *top = memory;
  for (int k = 0; k < %(n_in)d; top += U * nx[k++]) {
    x[k] = top;
    if (shared[k]) load_shared(a[k], nx[k], top, U);
  }
  for (int k = 0; k < %(n_out)d; top += U * ny[k++]) y[k] = top;
  i64 bad = 0;
  for (i64 block = begin; block < end; block += U * W) {
    /* Rows past the end repeat the last one, and are not stored. */
    i64 left = (end - block + A * W - 1) / (A * W) * A;
    int registers = left < U ? (int)left : U;
    for (int k = 0; k < %(n_in)d; k++)
      for (int j = 0; j < registers && !shared[k]; j++)
        load_rows(a[k], nx[k], block + j * W, end, x[k] + j, U);
    for (int j = 0; j < registers; j += A) {
      const V *in[%(n_in)d + 1];
      V *out[%(n_out)d + 1];
      for (int k = 0; k < %(n_in)d; k++) in[k] = x[k] + j;
      for (int k = 0; k < %(n_out)d; k++) out[k] = y[k] + j;
      kernel(in, out);
    }
    for (int j = 0; j < registers; j++) {
      V spoiled = {};
      for (int k = 0; k < %(n_out)d; k++) {
        for (i64 i = 0; i < ny[k]; i++) spoiled += y[k][i * U + j] - y[k][i * U + j];
        store_rows(b[k], ny[k], block + j * W, end, y[k] + j, U);
      }
      bad += count_rows(spoiled != 0.0, block + j * W, end);
    }
  }
  free(memory);
  return bad;
}
/* Threads draw chunks from one counter until there are none left. */
i64 run(i64 *next, i64 n, i64 chunk, const double *const *a, const i64 *shared,
        double *const *b);
i64 run(i64 *next, i64 n, i64 chunk, const double *const *a, const i64 *shared,
        double *const *b) {
  i64 bad = 0, begin;
  while ((begin = __atomic_fetch_add(next, chunk, __ATOMIC_RELAXED)) < n) {
    i64 lost = evaluate(begin, begin + chunk < n ? begin + chunk : n, a, shared, b);
    if (lost < 0) return -1;
    bad += lost;
  }
  return bad;
}
"""


class CompiledEngine:
    """Engine that evaluates a kernel for many samples by the compiled C function `run`, see :func:`batch_driver`.

    `evaluate(inputs, outputs, n)` takes arrays `(n, nnz)` or `(1, nnz)`, fills `outputs`, and
    returns the number of samples that are not finite. The constructor raises `CompilerError`.
    """

    def __init__(self, threads: int, text: str) -> None:
        level = 1 if len(text) > LONG_TEXT else 2
        self.threads, self._run = threads, compiler.load_library(text, ["run"], level).run
        self._run.restype = ctypes.c_int64
        self._run.argtypes = [ctypes.c_void_p, *2 * [ctypes.c_int64], *3 * [ctypes.c_void_p]]

    @property
    def address(self) -> int | None:
        """Address of the C function `run`."""
        return ctypes.cast(self._run, ctypes.c_void_p).value

    def evaluate(self, inputs: list[np.ndarray], outputs: list[np.ndarray], n: int) -> int:
        """Fill `outputs` for all n samples; return the number of samples that are not finite."""
        shared = np.array([a.shape[0] == 1 and n != 1 for a in inputs] + [False], dtype=np.int64)
        arguments = data_addresses(inputs), data_address(shared), data_addresses(outputs)
        return run_chunks(self._run, n, THREAD_CHUNK, self.threads, *arguments)


def data_addresses(arrays: list[np.ndarray]) -> ctypes.Array[ctypes.c_void_p]:
    """Return a C array of the arrays' data pointers."""
    return (ctypes.c_void_p * max(len(arrays), 1))(*map(data_address, arrays))


def data_address(array: np.ndarray) -> int:
    """Return the address of an array's data, in a tenth of the time of ``array.ctypes.data``."""
    try:
        return ctypes.addressof(ctypes.c_char.from_buffer(array.data))
    except (TypeError, ValueError):  # The array is read-only, empty or not contiguous.
        return array.__array_interface__["data"][0]


def batch_source(tape: Tape, block: int, machine: Compiler) -> str:
    """Return the C text that evaluates a tape on this computer, in blocks of about `block` samples."""
    abreast = ABREAST if len(tape.operations) <= LONG_GRAPH else ABREAST_IN_LONG_GRAPHS
    layout = RegisterLayout(("U",) * len(tape.input_sizes), ("U",) * len(tape.output_sizes), abreast)
    registers = abreast * max(1, block // (abreast * machine.width))
    return (
        vector_prelude(machine)
        + f"#define A {abreast}\n#define U {registers}\n"
        + c_source.kernel_source(tape, "kernel", layout, PART)
        + batch_driver(tape.input_sizes, tape.output_sizes)
    )


def batch_driver(input_sizes: Sequence[int], output_sizes: Sequence[int]) -> str:
    """Return the C text of `run`, which must follow the definitions of `A`, `U` and `kernel(in, out)`.

    Consecutive entries of the kernel's inputs and outputs are `U` registers apart.
    """
    return _DRIVER % {
        "input_sizes": ", ".join(map(str, (*input_sizes, 0))),
        "output_sizes": ", ".join(map(str, (*output_sizes, 0))),
        "nx": sum(input_sizes),
        "ny": sum(output_sizes),
        "n_in": len(input_sizes),
        "n_out": len(output_sizes),
    }
