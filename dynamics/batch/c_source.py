"""A tape as C: one function over SIMD registers, one statement per operation."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca

from dynamics.batch.parts import Parts
from dynamics.batch.tape import BOOLEAN, Operation, Tape, chosen

# gcc's time grows faster than a function's length; past this many operations a tape is cut.
PART = 1500
# Values, masks and arrays in a statement, which get the number of their lane behind them.
_NAMES = re.compile(r"\b([vm]\d+|in|out|w)\b")
_CALLS = {
    **{ca.OP_EXP: "vexp", ca.OP_LOG: "vlog", ca.OP_LOG1P: "vlog1p", ca.OP_EXPM1: "vexpm1"},
    **{ca.OP_SQRT: "vsqrt", ca.OP_POW: "vpow", ca.OP_ERF: "verf", ca.OP_ERFINV: "verfinv"},
    **{ca.OP_SIN: "vsin", ca.OP_COS: "vcos", ca.OP_TAN: "vtan"},
    **{ca.OP_ASIN: "vasin", ca.OP_ACOS: "vacos", ca.OP_ATAN: "vatan", ca.OP_ATAN2: "vatan2"},
    **{ca.OP_SINH: "vsinh", ca.OP_COSH: "vcosh", ca.OP_TANH: "vtanh"},
    **{ca.OP_ASINH: "vasinh", ca.OP_ACOSH: "vacosh", ca.OP_ATANH: "vatanh"},
    **{ca.OP_HYPOT: "vhypot", ca.OP_FMOD: "vfmod", ca.OP_REMAINDER: "vremainder"},
    **{ca.OP_COPYSIGN: "vcopysign", ca.OP_FMIN: "vfmin", ca.OP_FMAX: "vfmax"},
    **{ca.OP_FLOOR: "vfloor", ca.OP_CEIL: "vceil", ca.OP_FABS: "vfabs", ca.OP_SIGN: "vsign"},
}
_INFIX = {ca.OP_ADD: "+", ca.OP_SUB: "-", ca.OP_MUL: "*"}
_COMPARE = {ca.OP_LT: "<", ca.OP_LE: "<=", ca.OP_EQ: "==", ca.OP_NE: "!="}


def number(value: float) -> str:
    """A double as a C expression that gives exactly that double."""
    if math.isnan(value):
        return '__builtin_nan("")'
    if math.isinf(value):
        return "__builtin_inf()" if value > 0 else "(-__builtin_inf())"
    return f"({value.hex()})"


def _place(strides: Sequence[str], k: int, j: int) -> str:
    """Where entry j of array k is."""
    stride = strides[k] if k < len(strides) else "1"
    return str(j) if stride == "1" else f"{j} * {stride}"


def _in_lane(line: str, lane: int) -> str:
    return _NAMES.sub(rf"\1_{lane}", line)


@dataclass(frozen=True)
class Strides:
    """How far apart the entries of each input and output are: C expressions, "1" where not told.

    They may name `ts`, which a kernel with strides takes as its last argument.
    """

    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()


def kernel(
    tape: Tape, name: str, abreast: int = 1, part: int = PART, strides: Strides | None = None
) -> str:
    """C text of `static void name(const V *const in_0[], V *const out_0[], ...)`.

    `in_0[k][j]` is nonzero j of input k, `out_0` likewise; no output may overlap an input. With
    more than one `abreast` there are also in_1 and out_1 and so on, and every operation is written
    once for each of them in turn: a long chain of dependent operations leaves a processor idle that
    two such chains keep busy. A tape of more than `part` operations becomes several functions that
    pass values through memory.
    """
    return _Emitter(tape, name, abreast, part, strides).text()


class _Emitter:
    def __init__(
        self, tape: Tape, name: str, abreast: int, part: int, strides: Strides | None
    ) -> None:
        self.tape, self.name, self.lanes = tape, name, range(abreast)
        self.cut = Parts(tape, part)
        self.strides = strides or Strides()
        self.parameter, self.argument = (", i64 ts", ", ts") if strides else ("", "")

    def text(self) -> str:
        cut = self.cut
        names = [f"{self.name}_part{p}" for p in range(len(cut.parts))]
        body = [self._part(names[p], part, cut.ends[p]) for p, part in enumerate(cut.parts)]
        parameters = ", ".join(f"const V *const in_{k}[], V *const out_{k}[]" for k in self.lanes)
        memory = "".join(f"  V w_{k}[{max(cut.n_slots, 1)}];\n" for k in self.lanes)
        arguments = ", ".join(f"in_{k}, out_{k}, w_{k}" for k in self.lanes)
        calls = "".join(f"  {name}({arguments}{self.argument});\n" for name in names)
        head = f"INLINE void {self.name}({parameters}{self.parameter})"
        return "".join(body) + f"{head} {{\n{memory}{calls}}}\n"

    def _part(self, name: str, part: list[int], ends: Sequence[tuple[int, int, int]]) -> str:
        here = set(part)
        foreign = {a for i in part for a in self.cut.reads(self.tape.operations[i])} - here
        foreign |= {value for value, _, _ in ends} - here
        lines = [self._leaf(i) for i in sorted(foreign)]
        for i in part:
            lines.append(self._statement(i, here))
            if i in self.cut.slots:
                lines.append(f"w[{self.cut.slots[i]}] = v{i};")
        lines += [
            f"out[{k}][{_place(self.strides.outputs, k, j)}] = v{value};" for value, k, j in ends
        ]
        inline = "INLINE" if len(self.cut.parts) == 1 else "static __attribute__((noinline))"
        each = "const V *const in_{0}[], V *const out_{0}[], V *w_{0}"
        parameters = ", ".join(each.format(k) for k in self.lanes)
        body = "".join(f"  {_in_lane(line, k)}\n" for line in lines for k in self.lanes)
        return f"{inline} void {name}({parameters}{self.parameter}) {{\n{body}}}\n"

    def _leaf(self, i: int) -> str:
        operation = self.tape.operations[i]
        if operation.op == ca.OP_INPUT:
            k, j = operation.args
            return f"const V v{i} = in[{k}][{_place(self.strides.inputs, k, j)}];"
        if operation.op == ca.OP_CONST:
            return f"const V v{i} = SPLAT({number(operation.value)});"
        return f"const V v{i} = w[{self.cut.slots[i]}];" + (
            f" const M m{i} = v{i} != 0.0;" if operation.op in BOOLEAN else ""
        )

    def _statement(self, i: int, here: set[int]) -> str:
        operation = self.tape.operations[i]
        if operation.op in BOOLEAN:
            return f"const M m{i} = {self._condition(operation)}; const V v{i} = truth(m{i});"
        return f"const V v{i} = {self._expression(operation, here)};"

    def _mask(self, i: int) -> str:
        return f"m{i}" if self.tape.operations[i].op in BOOLEAN else f"(v{i} != 0.0)"

    def _condition(self, operation: Operation) -> str:
        args = operation.args
        if operation.op in _COMPARE:
            return f"v{args[0]} {_COMPARE[operation.op]} v{args[1]}"
        if operation.op == ca.OP_NOT:
            return f"~{self._mask(args[0])}"
        sign = "&" if operation.op == ca.OP_AND else "|"
        return f"{self._mask(args[0])} {sign} {self._mask(args[1])}"

    def _expression(self, operation: Operation, here: set[int]) -> str:
        op, v = operation.op, [f"v{a}" for a in operation.args]
        if op in (ca.OP_ADD, ca.OP_SUB):
            shorter = self._chosen(operation) or self._fused(operation, here)
            if shorter:
                return shorter
        if op == ca.OP_DIV:
            return self._quotient(operation)
        if op in _INFIX:
            return f"{v[0]} {_INFIX[op]} {v[1]}"
        if op in _CALLS:
            return f"{_CALLS[op]}({', '.join(v)})"
        if op == ca.OP_CONSTPOW:
            return self._power(operation)
        if op == ca.OP_IF_ELSE_ZERO:
            return f"keep({self._mask(operation.args[0])}, {v[1]})"
        return {
            ca.OP_NEG: f"-{v[0]}",
            ca.OP_SQ: f"{v[0]} * {v[0]}",
            ca.OP_TWICE: f"{v[0]} + {v[0]}",
            ca.OP_INV: f"1.0 / {v[0]}",
        }[op]

    def _power(self, operation: Operation) -> str:
        base, exponent = operation.args
        count = self.cut.power(operation)
        return " * ".join([f"v{base}"] * count) if count else f"vpow(v{base}, v{exponent})"

    def _quotient(self, operation: Operation) -> str:
        """A division, or for a constant divisor the product with its reciprocal."""
        a, b = operation.args
        reciprocal = self.cut.reciprocal(operation)
        return f"v{a} / v{b}" if reciprocal is None else f"v{a} * {number(reciprocal)}"

    def _chosen(self, operation: Operation) -> str:
        """CasADi's if_else as one selection; else an empty string."""
        choice = chosen(self.tape, operation)
        return "pick(m{}, v{}, v{})".format(*choice) if choice else ""

    def _fused(self, operation: Operation, here: set[int]) -> str:
        """a*b + c as one rounding where the product has no other reader; else an empty string."""
        left, right = operation.args
        minus = "-" if operation.op == ca.OP_SUB else ""
        factors = self.cut.factors(right, here)
        if factors:
            return f"fused({minus}v{factors[0]}, v{factors[1]}, v{left})"
        factors = self.cut.factors(left, here)
        if factors:
            return f"fused(v{factors[0]}, v{factors[1]}, {minus}v{right})"
        return ""
