"""NumPy backend: the tape run over cache-sized chunks of samples. Always available."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import casadi as ca
import numpy as np
from scipy import special

from dynamics.batch.parallel import over_chunks
from dynamics.batch.tape import Tape, operands

Array = np.ndarray
# A chunk's registers should fit the second-level cache; fewer samples, and calls cost more than
# arithmetic does.
CACHE_BYTES = 1 << 20


def _if_else_zero(condition: Array, value: Array, out: Array) -> None:
    # A product would turn 0 * inf into NaN; CasADi's operation does not.
    out[...] = np.where(condition != 0.0, value, 0.0)


def _reciprocal(a: Array, out: Array) -> None:
    np.divide(1.0, a, out=out)


def _twice(a: Array, out: Array) -> None:
    np.add(a, a, out=out)


_UFUNCS: dict[int, Callable[..., object]] = {
    **{ca.OP_ADD: np.add, ca.OP_SUB: np.subtract, ca.OP_MUL: np.multiply, ca.OP_DIV: np.divide},
    **{ca.OP_NEG: np.negative, ca.OP_SQ: np.square, ca.OP_TWICE: _twice, ca.OP_INV: _reciprocal},
    **{ca.OP_POW: np.power, ca.OP_CONSTPOW: np.power, ca.OP_SQRT: np.sqrt},
    **{ca.OP_EXP: np.exp, ca.OP_LOG: np.log, ca.OP_LOG1P: np.log1p, ca.OP_EXPM1: np.expm1},
    **{ca.OP_SIN: np.sin, ca.OP_COS: np.cos, ca.OP_TAN: np.tan},
    **{ca.OP_ASIN: np.arcsin, ca.OP_ACOS: np.arccos, ca.OP_ATAN: np.arctan},
    **{ca.OP_SINH: np.sinh, ca.OP_COSH: np.cosh, ca.OP_TANH: np.tanh},
    **{ca.OP_ASINH: np.arcsinh, ca.OP_ACOSH: np.arccosh, ca.OP_ATANH: np.arctanh},
    **{ca.OP_ATAN2: np.arctan2, ca.OP_HYPOT: np.hypot, ca.OP_COPYSIGN: np.copysign},
    **{ca.OP_LT: np.less, ca.OP_LE: np.less_equal, ca.OP_EQ: np.equal, ca.OP_NE: np.not_equal},
    **{ca.OP_NOT: np.logical_not, ca.OP_AND: np.logical_and, ca.OP_OR: np.logical_or},
    **{ca.OP_FLOOR: np.floor, ca.OP_CEIL: np.ceil, ca.OP_FABS: np.fabs, ca.OP_SIGN: np.sign},
    **{ca.OP_FMOD: np.fmod, ca.OP_FMIN: np.fmin, ca.OP_FMAX: np.fmax},
    **{ca.OP_ERF: special.erf, ca.OP_ERFINV: special.erfinv},
    ca.OP_IF_ELSE_ZERO: _if_else_zero,
}


def _remainder(a: Array, b: Array, out: Array) -> None:
    """IEEE remainder a - n b, n the integer nearest a/b (ties to even), exact as in C."""
    r = np.fmod(a, b)
    half = 0.5 * np.abs(b)
    n_odd = np.fmod(np.abs(a), 2.0 * np.abs(b)) >= np.abs(b)
    over = (np.abs(r) > half) | ((np.abs(r) == half) & n_odd)
    out[...] = np.where(over, r - np.copysign(np.abs(b), r), r)


_UFUNCS[ca.OP_REMAINDER] = _remainder


class NumpyKernel:
    """Evaluates a tape over samples in NumPy.

    `run(inputs, outputs)` takes one array `(nnz, m)` per input and fills one `(nnz, m)` per output:
    samples last, so that every operation is one contiguous pass. A row of shape `(1,)` broadcasts.
    Thread-safe: each call has its own registers.
    """

    def __init__(self, tape: Tape) -> None:
        self.tape = tape
        self._program = _allocate(tape)
        self.n_registers = 1 + max((step.target for step in self._program), default=-1)

    def run(self, inputs: Sequence[Array], outputs: Sequence[Array]) -> None:
        """Evaluate every sample; non-finite values pass through as IEEE arithmetic has them."""
        tape = self.tape
        m = max((row.shape[-1] for row in (*inputs, *outputs)), default=0)
        registers = list(np.empty((self.n_registers, m)))
        values: list[Array] = [np.empty(0)] * len(tape.operations)
        for i, operation in enumerate(tape.operations):
            if operation.op == ca.OP_INPUT:
                values[i] = inputs[operation.args[0]][operation.args[1]]
            elif operation.op == ca.OP_CONST:
                values[i] = np.array([operation.value])
        with np.errstate(all="ignore"):
            for step in self._program:
                out = registers[step.target]
                step.call(*[values[a] for a in step.args], out=out)
                values[step.index] = out
        for k, row in enumerate(tape.outputs):
            for j, value in enumerate(row):
                outputs[k][j] = values[value]


class _Step:
    """One computed operation: which function, on which values, into which register."""

    __slots__ = ("args", "call", "index", "target")

    def __init__(self, index: int, op: int, args: tuple[int, ...], target: int) -> None:
        self.index, self.args, self.target, self.call = index, args, target, _UFUNCS[op]


def _allocate(tape: Tape) -> list[_Step]:
    """Assign registers by liveness, so that the working set is the width of the graph."""
    last = tape.last_uses()
    free: list[int] = []
    register_of: dict[int, int] = {}
    n_registers = 0
    program: list[_Step] = []
    for i, operation in enumerate(tape.operations):
        if operation.op in (ca.OP_INPUT, ca.OP_CONST):
            continue
        if not free:
            free.append(n_registers)
            n_registers += 1
        register_of[i] = free.pop()
        program.append(_Step(i, operation.op, operation.args, register_of[i]))
        for arg in set(operands(operation)):
            if last[arg] == i and arg in register_of:
                free.append(register_of.pop(arg))
    return program


class NumpyEngine:
    """Evaluates a tape over samples in NumPy, chunk by chunk."""

    name = "numpy"

    def __init__(self, tape: Tape, threads: int, block: int) -> None:
        self.kernel, self.threads = NumpyKernel(tape), threads
        self._chunk = chunk_length(self.kernel.n_registers, block)

    def evaluate(self, inputs: list[Array], outputs: list[Array], n: int) -> int:
        """Fill `outputs` for all n samples; returns how many of them are not finite."""
        bad: list[int] = []

        def work(begin: int, end: int) -> None:
            rows = [np.ascontiguousarray(a[begin:end].T) if len(a) > 1 else a.T for a in inputs]
            results = [np.empty((a.shape[1], end - begin)) for a in outputs]
            self.kernel.run(rows, results)
            finite = np.ones(end - begin, dtype=bool)
            for array, result in zip(outputs, results, strict=True):
                array[begin:end] = result.T
                finite &= np.isfinite(result).all(axis=0)
            bad.append(int(np.count_nonzero(~finite)))

        over_chunks(n, self._chunk, self.threads, work)
        return sum(bad)


def chunk_length(n_rows: int, block: int) -> int:
    """Samples a chunk, a multiple of `block`, for `n_rows` live rows to stay in cache."""
    samples = min(4096, max(256, CACHE_BYTES // (8 * max(n_rows, 1))))
    return block * max(1, samples // block)
