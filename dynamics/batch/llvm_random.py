"""LLVM IR of the counter-based normals of `dynamics.batch.random`."""

from __future__ import annotations

import math

from llvmlite import ir

from dynamics.batch.llvm_vectors import I64, POINTER, Machine, Value, Writer, index
from dynamics.batch.random import INCREMENTS, MULTIPLIERS, ROUNDS, taylor

_LOW = 0xFFFFFFFF
_EXPONENT_OF_ONE = 0x3FF << 52
# Adding it rounds to the nearest integer and leaves that in the low bits.
_ROUNDER = 1.5 * 2.0**52


def four_normals(module: ir.Module, machine: Machine) -> None:
    """Write `four_normals(sample, quadruple, key0, key1, z)`, which fills four vectors.

    Lane l is for the sample `sample + l`.
    """
    w = Writer(module, machine, "four_normals", [I64, I64, I64, I64, POINTER])
    sample, quadruple, key0, key1, z = w.arguments
    words = _philox(w, sample, quadruple, [key0, key1])
    for pair in (0, 2):
        even, odd = _box_muller(w, words[pair], words[pair + 1])
        w.store(even, z, pair)
        w.store(odd, z, pair + 1)
    w.b.ret_void()


def _philox(w: Writer, sample: Value, quadruple: Value, key: list[Value]) -> list[Value]:
    b, low, half = w.b, w.whole(_LOW), w.whole(32)
    samples = b.add(w.spread(sample), ir.Constant(w.Q, list(range(w.lanes))))
    c = [b.and_(samples, low), b.lshr(samples, half), w.spread(quadruple), w.whole(0)]
    for _ in range(ROUNDS):
        p = [b.mul(c[0], w.whole(MULTIPLIERS[0])), b.mul(c[2], w.whole(MULTIPLIERS[1]))]
        c = [
            b.xor(b.xor(b.lshr(p[1], half), c[1]), w.spread(key[0])),
            b.and_(p[1], low),
            b.xor(b.xor(b.lshr(p[0], half), c[3]), w.spread(key[1])),
            b.and_(p[0], low),
        ]
        key = [
            b.and_(b.add(word, index(step)), index(_LOW))
            for word, step in zip(key, INCREMENTS, strict=True)
        ]
    return c


def _box_muller(w: Writer, first: Value, second: Value) -> tuple[Value, Value]:
    """Two normals of two words; the angle in quarter turns splits into a quadrant and the rest."""
    b, one = w.b, w.whole(1)
    logarithm = w.math("log", b.fadd(_unit(w, first), w.splat(2.0**-33)))
    radius = w.intrinsic("sqrt", b.fmul(w.splat(-2.0), logarithm))
    quarters = b.fmul(_unit(w, second), w.splat(4.0))
    shifted = b.fadd(quarters, w.splat(_ROUNDER))
    quadrant = b.bitcast(shifted, w.Q)
    rest = b.fsub(quarters, b.fsub(shifted, w.splat(_ROUNDER)))
    y = b.fmul(rest, w.splat(math.pi / 2))
    s, c = (_series(w, taylor(first), b.fmul(y, y)) for first in (1, 0))
    s = b.fmul(s, y)
    swap = b.icmp_unsigned("!=", b.and_(quadrant, one), w.whole(0))
    even = b.fmul(radius, w.pick(swap, s, c))
    odd = b.fmul(radius, w.pick(swap, c, s))
    return _turned(w, even, b.add(quadrant, one)), _turned(w, odd, quadrant)


def _unit(w: Writer, word: Value) -> Value:
    """word / 2^32: 32 bits below the exponent of 1 are a number in [1, 2)."""
    bits = w.b.or_(w.b.shl(word, w.whole(20)), w.whole(_EXPONENT_OF_ONE))
    return w.b.fsub(w.b.bitcast(bits, w.V), w.splat(1.0))


def _series(w: Writer, coefficients: list[float], y2: Value) -> Value:
    value: Value = w.splat(coefficients[0])
    for coefficient in coefficients[1:]:
        value = w.fused(value, y2, w.splat(coefficient))
    return value


def _turned(w: Writer, value: Value, quadrant: Value) -> Value:
    """The value with its sign turned where the second bit of `quadrant` is set."""
    sign = w.b.shl(w.b.and_(quadrant, w.whole(2)), w.whole(62))
    return w.b.bitcast(w.b.xor(w.b.bitcast(value, w.Q), sign), w.V)
