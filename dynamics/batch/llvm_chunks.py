"""LLVM IR of a driver's outermost loop, which several threads may run at once."""

from __future__ import annotations

from collections.abc import Sequence

from llvmlite import ir

from dynamics.batch.llvm_vectors import I64, POINTER, Machine, Writer, index


def run(module: ir.Module, machine: Machine, body: str, kinds: Sequence[ir.Type]) -> None:
    """Write `run(next, n, chunk, ...)`, which draws chunks of `range(n)` from the counter `next`.

    For each it calls `body(begin, end, chunk, ...)`, passing on its other arguments, of these
    kinds; it returns the sum of the results, or -1 after a negative one.
    """
    w = Writer(module, machine, "run", [POINTER, I64, I64, *kinds], I64)
    b, (counter, n, chunk, *rest) = w.b, w.arguments
    total = w.array(1, I64)
    w.store(index(0), total)
    head, here, after = (b.append_basic_block() for _ in range(3))
    b.branch(head)
    b.position_at_end(head)
    begin = b.atomic_rmw("add", counter, chunk, "monotonic")
    b.cbranch(b.icmp_signed("<", begin, n), here, after)
    b.position_at_end(here)
    end = b.add(begin, chunk)
    end = b.select(b.icmp_signed("<", end, n), end, n)
    result = w.call(body, begin, end, chunk, *rest, result=I64)
    with b.if_then(b.icmp_signed("<", result, index(0)), likely=False):
        b.ret(index(-1))
    w.store(b.add(w.load(total, 0, I64), result), total)
    b.branch(head)
    b.position_at_end(after)
    b.ret(w.load(total, 0, I64))
