"""LLVM backend of a batched function: the tape's kernel and a loop over vectors of samples."""

from __future__ import annotations

from llvmlite import ir

from dynamics.batch import llvm_chunks, llvm_rows, llvm_source
from dynamics.batch.llvm_vectors import I64, POINTER, Machine, Value, Writer, index
from dynamics.batch.tape import Tape

_VOID = ir.VoidType()


def module(tape: Tape, machine: Machine) -> ir.Module:
    """A module whose `run(next, n, chunk, a, shared, b)` is the driver of `c_flat`."""
    made = ir.Module(tape.name)
    llvm_rows.functions(made, machine)
    llvm_source.kernel(made, machine, tape, "kernel")
    w = Writer(made, machine, "evaluate", [*3 * [I64], *3 * [POINTER]], I64)
    begin, end, _, a, shared, b = w.arguments
    sizes = *tape.input_sizes, *tape.output_sizes
    # Not on the stack, which long inputs would burst.
    memory = w.allocate(index(sum(sizes) + 1))
    starts = [w.at(memory, sum(sizes[:k])) for k in range(len(sizes))]
    x, y = starts[: len(tape.input_sizes)], starts[len(tape.input_sizes) :]
    rows = [w.load(a, k, POINTER) for k in range(len(x))]
    answers = [w.load(b, k, POINTER) for k in range(len(y))]
    is_shared = [w.b.icmp_signed("!=", w.load(shared, k, I64), index(0)) for k in range(len(x))]
    for k, size in enumerate(tape.input_sizes):
        with w.b.if_then(is_shared[k]):
            _load(w, rows[k], size, index(0), begin, end, x[k])
    bad = w.array(1, I64)
    w.store(index(0), bad)
    with w.loop(begin, end, w.lanes) as row:
        for k, size in enumerate(tape.input_sizes):
            with w.b.if_then(w.b.not_(is_shared[k])):
                _load(w, rows[k], size, index(size), row.i, end, x[k])
        llvm_source.run_kernel(w, "kernel", *x, *y)
        spoiled = _spoiled(w, list(zip(y, tape.output_sizes, strict=True)))
        for k, size in enumerate(tape.output_sizes):
            w.call("store_rows", answers[k], index(size), row.i, end, y[k], result=_VOID)
        lost = w.how_many(w.b.and_(spoiled, w.below(row.i, end)))
        w.store(w.b.add(w.load(bad, 0, I64), lost), bad)
    w.free(memory)
    w.b.ret(w.load(bad, 0, I64))
    llvm_chunks.run(made, machine, "evaluate", 3 * [POINTER])
    return made


def _load(
    w: Writer,
    a: Value,
    size: int,
    stride: Value,
    row: Value,
    end: Value,
    out: Value,
) -> None:
    w.call("load_rows", a, index(size), stride, row, end, out, result=_VOID)


def _spoiled(w: Writer, arrays: list[tuple[Value, int]]) -> Value:
    """The mask of samples with a value that is not finite: such a value less itself is NaN."""
    total = w.array(1)
    w.store(w.splat(0.0), total)
    for array, size in arrays:
        with w.loop(0, size) as k:
            value = w.load(array, k.i)
            w.store(w.b.fadd(w.load(total), w.b.fsub(value, value)), total)
    return w.nonzero(w.load(total))
