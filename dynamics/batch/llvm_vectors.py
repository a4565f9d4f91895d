"""LLVM IR over vectors of doubles: functions, loops, and arithmetic lane by lane.

A vector has `lanes` doubles, one sample each: twice the width of a SIMD register, so that two
chains of dependent operations run abreast. Every operation acts on all lanes alike.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from llvmlite import ir

# llvmlite has no annotations, and what is inferred from its decorated methods is wrong.
Value = Any
I64, F64, BIT, POINTER = ir.IntType(64), ir.DoubleType(), ir.IntType(1), ir.PointerType()
# A row of the caller's array is aligned to a double, whatever it holds.
_ALIGNMENT = 8


@dataclass(frozen=True)
class Machine:
    """What code for this CPU may use: doubles a register, fused products, vector functions.

    `vector_math` maps the name of a C function to that of its vector version.
    """

    width: int
    has_fma: bool
    vector_math: dict[str, str]

    @property
    def lanes(self) -> int:
        """Doubles in a vector."""
        return 2 * self.width


@dataclass
class Loop:
    """A loop being written: its counter, and where it goes when it ends."""

    writer: Writer
    i: Value
    after: ir.Block

    def leave_if(self, condition: Value) -> None:
        """Leave the loop where `condition` holds."""
        go_on = self.writer.b.append_basic_block()
        self.writer.b.cbranch(condition, self.after, go_on)
        self.writer.b.position_at_end(go_on)


class Writer:
    """Writes one function of an LLVM module; `arguments` are its parameters."""

    def __init__(
        self,
        module: ir.Module,
        machine: Machine,
        name: str,
        parameters: Sequence[ir.Type],
        result: ir.Type | None = None,
        attribute: str | None = None,
    ) -> None:
        self.module, self.machine, self.lanes = module, machine, machine.lanes
        self.V, self.M = ir.VectorType(F64, self.lanes), ir.VectorType(BIT, self.lanes)
        self.Q = ir.VectorType(I64, self.lanes)
        kind = ir.FunctionType(result or ir.VoidType(), parameters)
        self.function = ir.Function(module, kind, name)
        if name != "run":
            self.function.linkage = "internal"
        if attribute:
            self.function.attributes.add(attribute)
        self.arguments: list[Value] = list(self.function.args)
        self.b: Any = ir.IRBuilder(self.function.append_basic_block("entry"))

    def splat(self, value: float) -> ir.Constant:
        """The number in every lane."""
        return ir.Constant(self.V, [value] * self.lanes)

    def whole(self, value: int) -> ir.Constant:
        """The integer in every lane."""
        return ir.Constant(self.Q, [value] * self.lanes)

    def spread(self, scalar: Value) -> Value:
        """A scalar, double or integer, in every lane."""
        kind = ir.VectorType(scalar.type, self.lanes)
        first = self.b.insert_element(ir.Constant(kind, ir.Undefined), scalar, index(0))
        mask = ir.Constant(ir.VectorType(ir.IntType(32), self.lanes), [0] * self.lanes)
        return self.b.shuffle_vector(first, ir.Constant(kind, ir.Undefined), mask)

    def at(self, pointer: Value, k: Value | int, kind: ir.Type | None = None) -> Value:
        """The address of entry k of an array of vectors, or of `kind`."""
        if isinstance(k, int) and k == 0:
            return pointer
        return self.b.gep(pointer, [index(k)], source_etype=kind or self.V)

    def load(self, pointer: Value, k: Value | int = 0, kind: ir.Type | None = None) -> Value:
        """Entry k of an array of vectors, or of `kind`."""
        return self.b.load(self.at(pointer, k, kind), align=_ALIGNMENT, typ=kind or self.V)

    def store(self, value: Value, pointer: Value, k: Value | int = 0) -> None:
        """Write entry k of an array of values like this one."""
        self.b.store(value, self.at(pointer, k, value.type), align=_ALIGNMENT)

    def array(self, size: int, kind: ir.Type | None = None) -> Value:
        """Room for `size` vectors, or values of `kind`, as long as the function runs."""
        with self.b.goto_entry_block():
            return self.b.alloca(kind or self.V, index(max(size, 1)))

    def allocate(self, size: Value) -> Value:
        """Room for `size` vectors, to be freed; the function returns -1 where there is none."""
        each = index(8 * self.lanes)
        memory = self.call("aligned_alloc", each, self.b.mul(size, each), result=POINTER)
        lacking = self.b.icmp_unsigned("==", self.b.ptrtoint(memory, I64), index(0))
        with self.b.if_then(lacking, likely=False):
            self.b.ret(index(-1))
        return memory

    def free(self, memory: Value) -> None:
        """Give back what `allocate` gave."""
        self.call("free", memory, result=ir.VoidType())

    @contextmanager
    def loop(self, start: Value | int, stop: Value | int, by: int = 1) -> Iterator[Loop]:
        """What is written inside is done for start, start + by, ... below stop."""
        b, before = self.b, self.b.block
        head, body, after = (b.append_basic_block() for _ in range(3))
        b.branch(head)
        b.position_at_end(head)
        i = b.phi(I64)
        i.add_incoming(index(start), before)
        b.cbranch(b.icmp_signed("<", i, index(stop)), body, after)
        b.position_at_end(body)
        yield Loop(self, i, after)
        i.add_incoming(b.add(i, index(by)), b.block)
        b.branch(head)
        b.position_at_end(after)

    def call(self, name: str, *arguments: Value, result: ir.Type) -> Value:
        """Call a function of the module or of the system, declared here where it is new."""
        known = self.module.globals.get(name)
        if known is None:
            kind = ir.FunctionType(result, [a.type for a in arguments])
            known = ir.Function(self.module, kind, name)
        return self.b.call(known, arguments)

    def intrinsic(self, name: str, *arguments: Value) -> Value:
        """An operation that LLVM has for vectors of doubles."""
        return self.call(f"llvm.{name}.v{self.lanes}f64", *arguments, result=self.V)

    def math(self, name: str, *arguments: Value) -> Value:
        """A function of C's mathematics: the vector library's, else lane by lane."""
        symbol = self.machine.vector_math.get(name)
        if symbol is None:
            return self.each_lane(name, *arguments)
        width = self.machine.width
        half = ir.VectorType(F64, width)
        halves = [
            self.call(symbol, *(self.register(a, k) for a in arguments), result=half)
            for k in range(0, self.lanes, width)
        ]
        return self.joined(*halves)

    def each_lane(self, name: str, *arguments: Value) -> Value:
        """A C function of doubles called for one lane after the other."""
        value: Value = ir.Constant(self.V, ir.Undefined)
        for lane in range(self.lanes):
            scalars = [self.b.extract_element(a, index(lane)) for a in arguments]
            one = self.call(name, *scalars, result=F64)
            value = self.b.insert_element(value, one, index(lane))
        return value

    def register(self, vector: Value, first: int) -> Value:
        """The SIMD register of a vector that begins at lane `first`."""
        return self.b.shuffle_vector(vector, vector, _lane_numbers(first, self.machine.width))

    def joined(self, first: Value, second: Value) -> Value:
        """A vector of its two registers."""
        return self.b.shuffle_vector(first, second, _lane_numbers(0, self.lanes))

    def fused(self, a: Value, b: Value, c: Value) -> Value:
        """a*b + c in one rounding; two where the CPU has no such instruction."""
        if self.machine.has_fma:
            return self.intrinsic("fma", a, b, c)
        return self.b.fadd(self.b.fmul(a, b), c)

    def negative(self, a: Value) -> Value:
        """-a, with the sign of zero and NaN turned too."""
        return self.b.fneg(a)

    def pick(self, mask: Value, a: Value, b: Value) -> Value:
        """a where the mask holds, else b."""
        return self.b.select(mask, a, b)

    def less(self, a: Value, b: Value) -> Value:
        """The mask of a < b."""
        return self.b.fcmp_ordered("<", a, b)

    def nonzero(self, a: Value) -> Value:
        """The mask of a != 0, which NaN is."""
        return self.b.fcmp_unordered("!=", a, self.splat(0.0))

    def lowest(self, a: Value, b: Value) -> Value:
        """The smaller; the other one where one is NaN, as C's fmin."""
        return self.pick(self.b.or_(self.less(a, b), self.b.fcmp_unordered("uno", b, b)), a, b)

    def highest(self, a: Value, b: Value) -> Value:
        """The larger; the other one where one is NaN, as C's fmax."""
        return self.pick(self.b.or_(self.less(b, a), self.b.fcmp_unordered("uno", b, b)), a, b)

    def any(self, mask: Value) -> Value:
        """Whether the mask holds in some lane."""
        bits = self.b.bitcast(mask, ir.IntType(self.lanes))
        return self.b.icmp_unsigned("!=", bits, ir.Constant(bits.type, 0))

    def below(self, row: Value, end: Value) -> Value:
        """The mask of the lanes l with row + l < end."""
        lanes = ir.Constant(self.Q, list(range(self.lanes)))
        return self.b.icmp_signed("<", lanes, self.spread(self.b.sub(end, row)))

    def how_many(self, mask: Value) -> Value:
        """In how many lanes the mask holds."""
        ones = self.b.zext(mask, self.Q)
        return self.call(f"llvm.vector.reduce.add.v{self.lanes}i64", ones, result=I64)

    def erfinv(self, x: Value) -> Value:
        """The inverse of erf, by the steps of `dynamics.batch.c_prelude`."""
        b, root_pi = self.b, self.splat(0.88622692545275801365)
        a, one = self.intrinsic("fabs", x), self.splat(1.0)
        c = b.fsub(one, a)
        g = self.math("log1p", b.fmul(self.negative(a), a))
        h = self.fused(self.splat(0.5), g, self.splat(4.3307467508))
        under = b.fsub(b.fmul(h, h), b.fmul(g, self.splat(6.8027210884)))
        y = self.intrinsic("sqrt", b.fsub(self.intrinsic("sqrt", under), h))
        near = self.less(a, self.splat(0.5))
        for _ in range(3):
            from_zero = b.fsub(self.each_lane("erf", y), a)
            from_one = b.fsub(c, self.each_lane("erfc", y))
            e = self.pick(near, from_zero, from_one)
            s = b.fmul(b.fmul(e, root_pi), self.math("exp", b.fmul(y, y)))
            y = b.fsub(y, b.fdiv(s, self.fused(y, s, one)))
        y = self.pick(self.less(a, self.splat(1e-8)), b.fmul(a, root_pi), y)
        at_end = b.fcmp_ordered("==", a, one)
        outside = self.pick(at_end, self.splat(float("inf")), self.splat(float("nan")))
        return self.intrinsic("copysign", self.pick(self.less(a, one), y, outside), x)


def index(k: Value | int) -> Value:
    """A whole number as an LLVM value."""
    return ir.Constant(I64, k) if isinstance(k, int) else k


def _lane_numbers(first: int, count: int) -> ir.Constant:
    kind = ir.VectorType(ir.IntType(32), count)
    return ir.Constant(kind, list(range(first, first + count)))
