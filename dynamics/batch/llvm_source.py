"""A tape as LLVM IR: one function over vectors of doubles, one value per operation."""

from __future__ import annotations

import casadi as ca
from llvmlite import ir

from dynamics.batch.llvm_vectors import POINTER, Machine, Value, Writer
from dynamics.batch.parts import Parts
from dynamics.batch.tape import BOOLEAN, Operation, Tape, chosen

# Allocating registers grows faster than a function's length.
PART = 1000
_MATH = {
    **{ca.OP_EXP: "exp", ca.OP_LOG: "log", ca.OP_LOG1P: "log1p", ca.OP_EXPM1: "expm1"},
    **{ca.OP_POW: "pow", ca.OP_CONSTPOW: "pow", ca.OP_ERF: "erf", ca.OP_HYPOT: "hypot"},
    **{ca.OP_SIN: "sin", ca.OP_COS: "cos", ca.OP_TAN: "tan"},
    **{ca.OP_ASIN: "asin", ca.OP_ACOS: "acos", ca.OP_ATAN: "atan", ca.OP_ATAN2: "atan2"},
    **{ca.OP_SINH: "sinh", ca.OP_COSH: "cosh", ca.OP_TANH: "tanh"},
    **{ca.OP_ASINH: "asinh", ca.OP_ACOSH: "acosh", ca.OP_ATANH: "atanh"},
    **{ca.OP_FMOD: "fmod", ca.OP_REMAINDER: "remainder"},
}
_INTRINSICS = {
    **{ca.OP_SQRT: "sqrt", ca.OP_FLOOR: "floor", ca.OP_CEIL: "ceil", ca.OP_FABS: "fabs"},
    ca.OP_COPYSIGN: "copysign",
}
_COMPARE = {ca.OP_LT: "<", ca.OP_LE: "<=", ca.OP_EQ: "=="}


def kernel(module: ir.Module, machine: Machine, tape: Tape, name: str) -> None:
    """Write `void name(in_0, ..., out_0, ...)`, pointers to arrays of vectors, to the module.

    Entry j of in_k is nonzero j of input k, of out_k likewise; no output may overlap an input. A
    tape of more than `PART` operations becomes several functions that pass values through memory.
    """
    cut = Parts(tape, PART)
    pointers = [POINTER] * (len(tape.input_sizes) + len(tape.output_sizes))
    if len(cut.parts) == 1:
        body = Writer(module, machine, name, [*pointers, POINTER], attribute="alwaysinline")
        _Emitter(body, cut, 0).write()
        return
    for p in range(len(cut.parts)):
        body = Writer(module, machine, f"{name}_part{p}", [*pointers, POINTER], None, "noinline")
        _Emitter(body, cut, p).write()
    whole = Writer(module, machine, name, [*pointers, POINTER])
    memory = whole.array(cut.n_slots)
    for p in range(len(cut.parts)):
        arguments = [*whole.arguments[:-1], memory]
        whole.call(f"{name}_part{p}", *arguments, result=ir.VoidType())
    whole.b.ret_void()


def run_kernel(w: Writer, name: str, *pointers: Value) -> None:
    """Call a kernel, inputs and then outputs."""
    nowhere = ir.Constant(POINTER, None)
    w.call(name, *pointers, nowhere, result=ir.VoidType())


class _Emitter:
    """Writes one part of a tape."""

    def __init__(self, w: Writer, cut: Parts, p: int) -> None:
        self.w, self.cut, self.tape = w, cut, cut.tape
        self.part, self.ends = cut.parts[p], cut.ends[p]
        self.here = set(self.part)
        n = len(self.tape.input_sizes)
        self.inputs, self.outputs = w.arguments[:n], w.arguments[n:-1]
        self.memory = w.arguments[-1]
        self.values: dict[int, Value] = {}
        self.masks: dict[int, Value] = {}

    def write(self) -> None:
        w = self.w
        targets: dict[int, list[tuple[int, int]]] = {}
        for value, k, j in self.ends:
            targets.setdefault(value, []).append((k, j))
        for i in self.part:
            self._compute(i)
            if i in self.cut.slots:
                w.store(self._value(i), self.memory, self.cut.slots[i])
            for k, j in targets.pop(i, ()):
                w.store(self._value(i), self.outputs[k], j)
        for i, places in targets.items():
            for k, j in places:
                w.store(self._value(i), self.outputs[k], j)
        w.b.ret_void()

    def _value(self, i: int) -> Value:
        """Value i as numbers: loaded, or made of a mask, when first asked for."""
        if i not in self.values:
            w, operation = self.w, self.tape.operations[i]
            if operation.op == ca.OP_CONST:
                value = w.splat(operation.value)
            elif operation.op == ca.OP_INPUT:
                value = w.load(self.inputs[operation.args[0]], operation.args[1])
            elif i in self.masks:
                value = w.pick(self.masks[i], w.splat(1.0), w.splat(0.0))
            else:
                value = w.load(self.memory, self.cut.slots[i])
            self.values[i] = value
        return self.values[i]

    def _mask(self, i: int) -> Value:
        if i not in self.masks:
            self.masks[i] = self.w.nonzero(self._value(i))
        return self.masks[i]

    def _compute(self, i: int) -> None:
        operation = self.tape.operations[i]
        if operation.op in BOOLEAN:
            self.masks[i] = self._condition(operation)
        else:
            self.values[i] = self._result(operation)

    def _condition(self, operation: Operation) -> Value:
        b, op, args = self.w.b, operation.op, operation.args
        if op in _COMPARE:
            return b.fcmp_ordered(_COMPARE[op], *map(self._value, args))
        if op == ca.OP_NE:
            return b.fcmp_unordered("!=", *map(self._value, args))
        if op == ca.OP_NOT:
            return b.not_(self._mask(args[0]))
        return (b.and_ if op == ca.OP_AND else b.or_)(*map(self._mask, args))

    def _result(self, operation: Operation) -> Value:
        w, op = self.w, operation.op
        if op in (ca.OP_ADD, ca.OP_SUB):
            return self._sum(operation)
        if op == ca.OP_IF_ELSE_ZERO:
            condition, value = operation.args
            return w.pick(self._mask(condition), self._value(value), w.splat(0.0))
        if op == ca.OP_CONSTPOW and self.cut.power(operation):
            return self._power(operation)
        v = [self._value(arg) for arg in operation.args]
        if op in _MATH:
            return w.math(_MATH[op], *v)
        if op in _INTRINSICS:
            return w.intrinsic(_INTRINSICS[op], *v)
        return self._arithmetic(operation, *v)

    def _arithmetic(self, operation: Operation, a: Value, c: Value | None = None) -> Value:
        w, op = self.w, operation.op
        if op == ca.OP_DIV:
            reciprocal = self.cut.reciprocal(operation)
            return w.b.fdiv(a, c) if reciprocal is None else w.b.fmul(a, w.splat(reciprocal))
        if op == ca.OP_SIGN:
            positive = w.pick(w.less(w.splat(0.0), a), w.splat(1.0), a)
            return w.pick(w.less(a, w.splat(0.0)), w.splat(-1.0), positive)
        return {
            ca.OP_MUL: lambda: w.b.fmul(a, c),
            ca.OP_FMIN: lambda: w.lowest(a, c),
            ca.OP_FMAX: lambda: w.highest(a, c),
            ca.OP_NEG: lambda: w.negative(a),
            ca.OP_SQ: lambda: w.b.fmul(a, a),
            ca.OP_TWICE: lambda: w.b.fadd(a, a),
            ca.OP_INV: lambda: w.b.fdiv(w.splat(1.0), a),
            ca.OP_ERFINV: lambda: w.erfinv(a),
        }[op]()

    def _power(self, operation: Operation) -> Value:
        base = self._value(operation.args[0])
        value = base
        for _ in range((self.cut.power(operation) or 1) - 1):
            value = self.w.b.fmul(value, base)
        return value

    def _sum(self, operation: Operation) -> Value:
        """A sum or difference: CasADi's if_else as one selection, a*b + c as one rounding."""
        w, (left, right) = self.w, operation.args
        choice = chosen(self.tape, operation)
        if choice:
            return w.pick(self._mask(choice[0]), self._value(choice[1]), self._value(choice[2]))
        minus = operation.op == ca.OP_SUB
        factors = self.cut.factors(right, self.here)
        if factors:
            a, c = map(self._value, factors)
            return w.fused(w.negative(a) if minus else a, c, self._value(left))
        factors = self.cut.factors(left, self.here)
        if factors:
            a, c = map(self._value, factors)
            last = self._value(right)
            return w.fused(a, c, w.negative(last) if minus else last)
        return (w.b.fsub if minus else w.b.fadd)(self._value(left), self._value(right))
