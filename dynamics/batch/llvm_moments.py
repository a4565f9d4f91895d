"""LLVM IR of one chunk's moments: sums lane by lane, then the lanes merged in order.

Sums are about the first vector of samples. Samples that are not finite, and the padding, are left
out.
"""

from __future__ import annotations

from llvmlite import ir

from dynamics.batch.llvm_vectors import F64, I64, POINTER, Machine, Value, Writer, index

_VOID = ir.VoidType()


def finite(w: Writer, blocks: list[tuple[Value, Value]]) -> Value:
    """The mask of lanes whose values, arrays with their sizes, are all finite.

    A sum is finite only if all its terms are; one that overflows counts as not finite too.
    """
    total = w.array(1)
    w.store(w.splat(0.0), total)
    for values, size in blocks:
        with w.loop(0, size) as k:
            w.store(w.b.fadd(w.load(total), w.load(values, k.i)), total)
    value = w.load(total)
    return w.b.fcmp_ordered("ord", w.b.fsub(value, value), w.splat(0.0))


class Moments:
    """Accumulators of `n_values` values, vectors `pivot`, `sum` and `square`, at `memory`."""

    def __init__(self, w: Writer, memory: Value, n_values: Value) -> None:
        self.w, self.memory, self.n = w, memory, n_values
        self.count = w.array(1, w.Q)

    def clear(self) -> None:
        """Begin a chunk."""
        w = self.w
        w.store(w.whole(0), self.count)
        with w.loop(0, w.b.mul(index(3), self.n)) as k:
            w.store(w.splat(0.0), self.memory, k.i)

    def add(self, blocks: list[tuple[Value, Value]], ok: Value, starting: Value) -> None:
        """Add a vector of samples where the mask `ok` holds; the first of a chunk is the pivot."""
        w, b = self.w, self.w.b
        w.store(b.add(w.load(self.count, 0, w.Q), b.zext(ok, w.Q)), self.count)
        begin: Value = index(0)
        mask = w.array(1)
        w.store(w.pick(ok, w.splat(1.0), w.splat(0.0)), mask)
        for values, size in blocks:
            place = w.at(self.memory, begin)
            first = b.zext(starting, I64)
            w.call("accumulate", place, self.n, values, size, mask, first, result=_VOID)
            begin = b.add(begin, size)

    def finish(self, out: Value) -> None:
        """Write the row (count, means, second moments)."""
        self.w.call("merge_lanes", self.memory, self.n, self.count, out, result=_VOID)


def functions(module: ir.Module, machine: Machine) -> None:
    """Write `accumulate` and `merge_lanes`, which `Moments` calls."""
    _accumulate(Writer(module, machine, "accumulate", [POINTER, I64, *2 * [POINTER, I64]]))
    _merge_lanes(Writer(module, machine, "merge_lanes", [POINTER, I64, POINTER, POINTER]))


def _accumulate(w: Writer) -> None:
    b, (pivot, n, values, size, mask, starting) = w.b, w.arguments
    ok, zero = w.nonzero(w.load(mask)), w.splat(0.0)
    sums, squares = w.at(pivot, n), w.at(pivot, b.shl(n, index(1)))
    with b.if_then(b.icmp_signed("!=", starting, index(0))), w.loop(0, size) as k:
        w.store(w.pick(ok, w.load(values, k.i), zero), pivot, k.i)
    with w.loop(0, size) as k:
        d = w.pick(ok, b.fsub(w.load(values, k.i), w.load(pivot, k.i)), zero)
        w.store(b.fadd(w.load(sums, k.i), d), sums, k.i)
        w.store(w.fused(d, d, w.load(squares, k.i)), squares, k.i)
    b.ret_void()


def _merge_lanes(w: Writer) -> None:
    """Chan's merge of each value's lanes, from the first to the last."""
    b, (memory, n, counts, out) = w.b, w.arguments
    count = w.load(counts, 0, w.Q)
    total = w.call(f"llvm.vector.reduce.add.v{w.lanes}i64", count, result=I64)
    w.store(b.sitofp(total, F64), out)
    mean, m2, many = (w.array(1, F64) for _ in range(3))
    with w.loop(0, n) as k:
        for number in (mean, m2, many):
            w.store(ir.Constant(F64, 0.0), number)
        pivot, sums, squares = (
            w.load(memory, b.add(k.i, b.mul(n, index(part)))) for part in range(3)
        )
        with w.loop(0, w.lanes) as lane:
            more = b.sitofp(b.extract_element(count, lane.i), F64)
            with b.if_then(b.fcmp_ordered(">", more, ir.Constant(F64, 0.0))):
                lanes = [b.extract_element(v, lane.i) for v in (pivot, sums, squares)]
                _merge_lane(w, lanes, more, (mean, m2, many))
        w.store(w.load(mean, 0, F64), out, b.add(index(1), k.i))
        w.store(w.load(m2, 0, F64), out, b.add(b.add(index(1), n), k.i))
    b.ret_void()


def _merge_lane(
    w: Writer, lane: list[Value], more: Value, merged: tuple[Value, Value, Value]
) -> None:
    b, (pivot, total, square) = w.b, lane
    mean, m2, many = (w.load(number, 0, F64) for number in merged)
    own_mean = b.fdiv(total, more)
    own_m2 = b.fsub(square, b.fmul(total, own_mean))
    zero = ir.Constant(F64, 0.0)
    own_m2 = b.select(b.fcmp_ordered(">", own_m2, zero), own_m2, zero)
    count = b.fadd(many, more)
    difference = b.fsub(b.fadd(pivot, own_mean), mean)
    share = b.fdiv(more, count)
    w.store(b.fadd(mean, b.fmul(difference, share)), merged[0])
    spread = b.fmul(b.fmul(difference, difference), b.fmul(many, share))
    w.store(b.fadd(m2, b.fadd(own_m2, spread)), merged[1])
    w.store(count, merged[2])
