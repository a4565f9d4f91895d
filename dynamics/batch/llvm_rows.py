"""LLVM IR that takes rows of the caller's `(n_samples, size)` arrays to vectors and back.

Whole tiles, as many entries as a SIMD register holds, are transposed in registers; the entries
left over go lane by lane.
"""

from __future__ import annotations

from llvmlite import ir

from dynamics.batch.llvm_vectors import F64, I64, POINTER, Machine, Value, Writer, index


def functions(module: ir.Module, machine: Machine) -> None:
    """Write `load_rows` and `store_rows`.

    `load_rows(a, size, stride, row, end, out)`: lane l of vector k is entry k of row `row + l`, or
    of row `end - 1` past the last one; rows are `stride` apart, 0 for one row that all share.
    `store_rows(a, size, row, end, in)` leaves out what lies past the last row.
    """
    _load_rows(Writer(module, machine, "load_rows", [POINTER, *4 * [I64], POINTER]))
    _store_rows(Writer(module, machine, "store_rows", [POINTER, *3 * [I64], POINTER]))


def fetch(w: Writer, a: Value, entries: Value, share: tuple[Value, Value], write: bool) -> None:
    """Ask the cache for part t of n of the next `entries` entries at `a`, where `share` is (t, n).

    Spread over a loop of n turns it hides the memory's delay; it changes no result.
    """
    b, (t, n) = w.b, share
    lines = b.add(b.sdiv(entries, index(8)), index(1))
    each = b.add(b.sdiv(lines, n), index(1))
    begin = b.mul(t, each)
    end = b.add(begin, each)
    flags = [ir.Constant(ir.IntType(32), flag) for flag in (int(write), 3, 1)]
    with w.loop(begin, b.select(b.icmp_signed("<", end, lines), end, lines)) as k:
        place = w.at(a, b.mul(k.i, index(8)), F64)
        w.call("llvm.prefetch.p0", place, *flags, result=ir.VoidType())


def _load_rows(w: Writer) -> None:
    b, (a, size, stride, row, end, out) = w.b, w.arguments
    width, register = w.machine.width, ir.VectorType(F64, w.machine.width)
    last = b.sub(end, index(1))
    starts = []
    for lane in range(w.lanes):
        here = b.add(row, index(lane))
        here = b.select(b.icmp_signed("<", here, last), here, last)
        starts.append(w.at(a, b.mul(here, stride), F64))
    tiled = b.sub(size, b.srem(size, index(width)))
    with w.loop(0, tiled, width) as k:
        entries = [w.load(w.at(start, k.i, F64), 0, register) for start in starts]
        tiles = [
            _transposed(w, entries[first : first + width]) for first in range(0, w.lanes, width)
        ]
        for entry, halves in enumerate(zip(*tiles, strict=True)):
            w.store(w.joined(*halves), out, b.add(k.i, index(entry)))
    with w.loop(tiled, size) as k:
        value: Value = ir.Constant(w.V, ir.Undefined)
        for lane, start in enumerate(starts):
            value = b.insert_element(value, w.load(start, k.i, F64), index(lane))
        w.store(value, out, k.i)
    b.ret_void()


def _store_rows(w: Writer) -> None:
    b, (_, _, row, end, _) = w.b, w.arguments
    whole = b.icmp_signed("<=", b.add(row, index(w.lanes)), end)
    with b.if_else(whole) as (all_of_them, some):
        with all_of_them:
            _store_all(w)
        with some:
            _store_some(w)
    b.ret_void()


def _store_all(w: Writer) -> None:
    b, (a, size, row, _, values) = w.b, w.arguments
    width = w.machine.width
    starts = [w.at(a, b.mul(b.add(row, index(lane)), size), F64) for lane in range(w.lanes)]
    tiled = b.sub(size, b.srem(size, index(width)))
    with w.loop(0, tiled, width) as k:
        vectors = [w.load(values, b.add(k.i, index(entry))) for entry in range(width)]
        for first in range(0, w.lanes, width):
            tile = _transposed(w, [w.register(v, first) for v in vectors])
            for start, entries in zip(starts[first : first + width], tile, strict=True):
                w.store(entries, w.at(start, k.i, F64))
    with w.loop(tiled, size) as k:
        value = w.load(values, k.i)
        for lane, start in enumerate(starts):
            w.store(b.extract_element(value, index(lane)), start, k.i)


def _store_some(w: Writer) -> None:
    b, (a, size, row, end, values) = w.b, w.arguments
    with w.loop(row, end) as r, w.loop(0, size) as k:
        one = b.extract_element(w.load(values, k.i), b.sub(r.i, row))
        w.store(one, a, b.add(b.mul(r.i, size), k.i))


def _transposed(w: Writer, tile: list[Value]) -> list[Value]:
    """Columns of a square tile of registers, by rounds of pairwise shuffles."""
    tile, width = list(tile), len(tile)
    lanes = ir.VectorType(ir.IntType(32), width)
    distance = 1
    while distance < width:
        low = [i if not i & distance else width + i - distance for i in range(width)]
        high = [i + distance if not i & distance else width + i for i in range(width)]
        for i in range(width):
            if not i & distance:
                pair = tile[i], tile[i + distance]
                tile[i] = w.b.shuffle_vector(*pair, ir.Constant(lanes, low))
                tile[i + distance] = w.b.shuffle_vector(*pair, ir.Constant(lanes, high))
        distance *= 2
    return tile
