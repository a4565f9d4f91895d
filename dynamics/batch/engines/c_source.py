"""C source of a tape: one function over SIMD registers or plain doubles, one statement per operation."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import chain

import casadi as ca

from dynamics.batch.graphs.tape import BOOLEAN, Operation, Tape, operands_of, selection_of

# Maximum number of operations of one C function; a longer tape is cut into parts, as gcc's time and
# the number of values that it moves between registers and memory grow faster than the length.
WHOLE = 1500
# Number of operations of each part of a longer tape.
PART = 300
# Maximum number of operations of a function that is inlined; calls of longer functions cost little, and callers
# of such functions compile faster.
INLINED = 150
# Largest integer exponent written as a product, since the vector pow only approximates it.
LARGEST_PRODUCT = 4
# Range of constant divisors that are replaced by their reciprocal; a division takes as long as ten products.
MODERATE = (1e-300, 1e300)
# Operations that have no operands.
_LEAVES = (ca.OP_INPUT, ca.OP_CONST)
# Pattern of the names of values and masks in a C statement.
_NAMES = re.compile(r"\b[vm]\d+\b")
# What precedes the name that a statement defines, with a type of one letter.
_BEFORE_NAME = len("const V ")
# Mapping from an operation of CasADi to its C function.
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
# Faster C functions of operations; if an operand is NaN, their result depends on the processor.
_LOOSE = {ca.OP_FMIN: "vsmaller", ca.OP_FMAX: "vlarger"}
# C operators of arithmetic.
_INFIX = {ca.OP_ADD: "+", ca.OP_SUB: "-", ca.OP_MUL: "*"}
# C operators of comparison.
_COMPARE = {ca.OP_LT: "<", ca.OP_LE: "<=", ca.OP_EQ: "==", ca.OP_NE: "!="}


def c_double(value: float) -> str:
    """Return a C expression whose value is exactly this double."""
    if math.isnan(value):
        return "NOT_A_NUMBER"
    if math.isinf(value):
        return "INFINITE" if value > 0 else "(-INFINITE)"
    return f"({value.hex()})"


@dataclass(frozen=True)
class RegisterLayout:
    """Memory layout of a kernel's inputs and outputs, for a kernel that works on several registers at once.

    Entry j of an array for register r is at index `j * stride + r`, or at `j` if the stride is 1 and all registers
    share the entry. Strides are C expressions, "1" by default; they may contain `ts`, which is then the kernel's last
    argument. The kernel works on `abreast` registers at once, since in one long chain of dependent operations each
    would wait for the previous one. With `loose` the result of a minimum or maximum of a NaN depends on the
    processor.
    """

    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()
    abreast: int = 1
    loose: bool = False

    @property
    def with_ts(self) -> bool:
        """Whether the kernel has the argument `ts`, a stride that is known at run time."""
        return "ts" in (*self.inputs, *self.outputs)

    @staticmethod
    def entry_offset(strides: Sequence[str], k: int, j: int, register: int) -> str:
        """Return the index, as a C expression, of entry j of array k for a register."""
        stride = strides[k] if k < len(strides) else "1"
        if stride == "1":
            return str(j)
        offset = f"{j} * {stride}"
        return offset if register == 0 else f"{offset} + ({stride} > 1) * {register}"


def kernel_source(tape: Tape, name: str, layout: RegisterLayout | None = None, part_size: int | None = None) -> str:
    """Return the C text of `void name(const V *const in[], V *const out[])`, which evaluates a tape.

    `in[k][j]` is nonzero j of input k and `out[k][j]` nonzero j of output k, at the indices of `layout`; no
    output may overlap an input. A long tape becomes several functions, of `part_size` operations if given,
    which pass values through memory.
    """
    if part_size is None:
        part_size = WHOLE if len(tape.operations) <= WHOLE else PART
    return _KernelEmitter(tape, name, layout or RegisterLayout(), part_size).source_text()


class _TapeParts:
    """Partition of the computed values of `tape`, in order, into parts of at most `size` values.

    `parts[p]` lists the values of part p; `slots` maps each value that a later part reads to its
    slot in memory, out of `n_slots`; `ends[p]` lists the outputs (value, output, nonzero) that part p
    writes. A slot is reused after the last read of its value.
    """

    def __init__(self, tape: Tape, size: int) -> None:
        self.tape = tape
        self.counts = tape.use_counts()
        computed = [i for i, o in enumerate(tape.operations) if o.op not in _LEAVES]
        self.parts = [computed[k : k + size] for k in range(0, len(computed), size)] or [[]]
        self._part_of = {i: p for p, members in enumerate(self.parts) for i in members}
        self.slots: dict[int, int] = {}
        self.n_slots = 0
        self._spill()
        self.ends = self._output_parts()

    def read_values(self, operation: Operation) -> tuple[int, ...]:
        """Return the values that an operation reads: its operands, or those of the selection for an `if_else`."""
        return operands_of(operation) + (selection_of(self.tape, operation) or ())

    def product_factors(self, i: int, members: set[int]) -> tuple[int, int] | None:
        """Return the two factors of value i if it is a product in `members` that is read only once, else None."""
        operation = self.tape.operations[i]
        if i not in members or self.counts[i] != 1:
            return None
        if operation.op == ca.OP_MUL:
            return operation.args[0], operation.args[1]
        if operation.op == ca.OP_SQ:
            return operation.args[0], operation.args[0]
        return None

    def integer_power(self, operation: Operation) -> int | None:
        """Return the exponent of `OP_CONSTPOW` if it is a small positive integer, else None."""
        exponent = self.tape.operations[operation.args[1]]
        is_small_integer = exponent.op == ca.OP_CONST and exponent.value in range(1, LARGEST_PRODUCT + 1)
        return int(exponent.value) if is_small_integer else None

    def constant_reciprocal(self, operation: Operation) -> float | None:
        """Return the reciprocal of a division's divisor; None unless it is a constant in the range `MODERATE`."""
        divisor = self.tape.operations[operation.args[1]]
        moderate = divisor.op == ca.OP_CONST and MODERATE[0] < abs(divisor.value) < MODERATE[1]
        return 1.0 / divisor.value if moderate else None

    def _spill(self) -> None:
        last = self._last_parts()
        last_read_in: list[list[int]] = [[] for _ in self.parts]
        for i, p in last.items():
            last_read_in[p].append(i)
        free: list[int] = []
        for p, members in enumerate(self.parts):
            for i in members:
                if last.get(i, p) > p:
                    if not free:
                        free.append(self.n_slots)
                        self.n_slots += 1
                    self.slots[i] = free.pop()
            free += [self.slots[i] for i in last_read_in[p] if i in self.slots]

    def _last_parts(self) -> dict[int, int]:
        last: dict[int, int] = {}
        for i, p in self._part_of.items():
            for arg in self.read_values(self.tape.operations[i]):
                if arg in self._part_of:
                    last[arg] = p  # Parts are visited in their order.
        return last

    def _output_parts(self) -> list[list[tuple[int, int, int]]]:
        ends: list[list[tuple[int, int, int]]] = [[] for _ in self.parts]
        for k, row in enumerate(self.tape.outputs):
            for j, value in enumerate(row):
                ends[self._part_of.get(value, 0)].append((value, k, j))
        return ends


class _KernelEmitter:
    def __init__(self, tape: Tape, name: str, layout: RegisterLayout, part_size: int) -> None:
        self.name, self.layout, self.parts = name, layout, _TapeParts(tape, part_size)

    def source_text(self) -> str:
        parts, registers = self.parts, self.layout.abreast
        if len(parts.parts) == 1:
            linkage = "INLINE" if len(parts.parts[0]) <= INLINED else "static NOINLINE"
            return self._function(linkage, self.name, self._body(0))
        names = [f"{self.name}_part{p}" for p in range(len(parts.parts))]
        part_functions = [
            self._function("static NOINLINE", name, self._body(p), ", V *w") for p, name in enumerate(names)
        ]
        calls = [f"V w[{max(parts.n_slots, 1) * registers}];"]
        calls += [f"{name}(in, out{', ts' * self.layout.with_ts}, w);" for name in names]
        return "".join(part_functions) + self._function("INLINE", self.name, calls)

    def _function(self, linkage: str, name: str, lines: list[str], extra_parameter: str = "") -> str:
        parameters = "const V *const in[], V *const out[]" + ", i64 ts" * self.layout.with_ts + extra_parameter
        body = "\n".join(lines)
        for word in re.findall(r"(\w+)(?:\[\])?(?:,|$)", parameters):
            if not re.search(rf"\b{word}\b", body):
                lines = [f"(void){word};", *lines]
        text = "".join(f"  {line}\n" for line in lines)
        return f"{linkage} void {name}({parameters}) {{\n{text}}}\n"

    def _body(self, p: int) -> list[str]:
        """Return the C statements of part p, each repeated for every register."""
        registers = range(self.layout.abreast)
        by_register = [_PartEmitter(self.parts, p, self.layout, r).statement_lines() for r in registers]
        return list(chain.from_iterable(zip(*by_register, strict=True)))


class _PartEmitter:
    """Writer of the C statements of one part of a tape, for one of the kernel's registers."""

    def __init__(self, parts: _TapeParts, p: int, layout: RegisterLayout, register: int) -> None:
        self.parts, self.tape, self.layout, self.register = parts, parts.tape, layout, register
        self.own_values, self.own_set = parts.parts[p], set(parts.parts[p])
        self.stores: dict[int, list[str]] = {}
        for i in self.own_values:
            if i in parts.slots:
                self.stores.setdefault(i, []).append(f"{self._slot(i)} = v{i};")
        for i, k, j in parts.ends[p]:
            offset = layout.entry_offset(layout.outputs, k, j, register)
            self.stores.setdefault(i, []).append(f"out[{k}][{offset}] = v{i};")

    def statement_lines(self) -> list[str]:
        """Return the C statements, with each constant, input or value from memory loaded before its first use."""
        lines: list[str] = []
        defined = {f"{kind}{i}" for i in self.own_values for kind in "vm"}
        for line, names in self._used_statements():
            for name in names:
                if name not in defined:
                    defined.add(name)
                    lines.append(self._leaf(name[0], int(name[1:])))
            lines.append(line)
        if self.layout.abreast == 1:
            return lines
        pieces = re.split(f"({_NAMES.pattern})", "\n".join(lines))
        pieces[1::2] = [f"{name}_{self.register}" for name in pieces[1::2]]
        return "".join(pieces).splitlines()

    def _used_statements(self) -> Iterable[tuple[str, list[str]]]:
        """Yield in order the C statements whose result is used, each with the names in it."""
        output_lines = [line for i, lines in self.stores.items() if i not in self.own_set for line in lines]
        reverse = [(line, _NAMES.findall(line)) for line in output_lines[::-1]]
        used_names = {name for _, names in reverse for name in names}
        for i in reversed(self.own_values):
            for line in (*self.stores.get(i, [])[::-1], *self._statements(i)):
                if not line.startswith("const ") or line[_BEFORE_NAME : line.index(" =")] in used_names:
                    names = _NAMES.findall(line)
                    used_names.update(names)
                    reverse.append((line, names))
        return reversed(reverse)

    def _slot(self, i: int) -> str:
        return f"w[{self.parts.slots[i] * self.layout.abreast + self.register}]"

    def _leaf(self, kind: str, i: int) -> str:
        operation = self.tape.operations[i]
        if operation.op == ca.OP_INPUT:
            k, j = operation.args
            offset = self.layout.entry_offset(self.layout.inputs, k, j, self.register)
            return f"const V v{i} = in[{k}][{offset}];"
        if operation.op == ca.OP_CONST:
            return f"const V v{i} = SPLAT({c_double(operation.value)});"
        return f"const {kind.upper()} {kind}{i} = {self._slot(i)}{' != 0.0' * (kind == 'm')};"

    def _statements(self, i: int) -> tuple[str, ...]:
        """Return the C statements that define value i, last statement first."""
        operation = self.tape.operations[i]
        if operation.op in BOOLEAN:
            condition = self._condition(operation)
            return f"const V v{i} = truth(m{i});", f"const M m{i} = {condition};"
        return (f"const V v{i} = {self._expression(operation)};",)

    def _mask(self, i: int) -> str:
        return f"m{i}" if self.tape.operations[i].op in BOOLEAN else f"(v{i} != 0.0)"

    def _condition(self, operation: Operation) -> str:
        args = operation.args
        if operation.op in _COMPARE:
            return f"v{args[0]} {_COMPARE[operation.op]} v{args[1]}"
        if operation.op == ca.OP_NOT:
            return f"NOT({self._mask(args[0])})"
        sign = "&" if operation.op == ca.OP_AND else "|"
        return f"{self._mask(args[0])} {sign} {self._mask(args[1])}"

    def _expression(self, operation: Operation) -> str:
        op, v = operation.op, [f"v{a}" for a in operation.args]
        if op in (ca.OP_ADD, ca.OP_SUB):
            combined = self._selection(operation) or self._fused(operation)
            if combined:
                return combined
        if op == ca.OP_DIV:
            return self._quotient(operation)
        if op in _INFIX:
            return f"{v[0]} {_INFIX[op]} {v[1]}"
        if op in _LOOSE and self.layout.loose:
            return f"{_LOOSE[op]}({', '.join(v)})"
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
        count = self.parts.integer_power(operation)
        return " * ".join([f"v{base}"] * count) if count else f"vpow(v{base}, v{exponent})"

    def _quotient(self, operation: Operation) -> str:
        """Return the C expression of a division; with a constant divisor this is a product with the reciprocal."""
        a, b = operation.args
        reciprocal = self.parts.constant_reciprocal(operation)
        return f"v{a} / v{b}" if reciprocal is None else f"v{a} * {c_double(reciprocal)}"

    def _selection(self, operation: Operation) -> str:
        """Return the C expression of CasADi's `if_else` as one conditional selection, "" for other operations."""
        choice = selection_of(self.tape, operation)
        return "pick(m{}, v{}, v{})".format(*choice) if choice else ""

    def _fused(self, operation: Operation) -> str:
        """Return a*b + c as one fused C call if no other operation reads the product, else ""."""
        left_operand, right_operand = operation.args
        minus = "-" if operation.op == ca.OP_SUB else ""
        factors = self.parts.product_factors(right_operand, self.own_set)
        if factors:
            return f"fused({minus}v{factors[0]}, v{factors[1]}, v{left_operand})"
        factors = self.parts.product_factors(left_operand, self.own_set)
        if factors:
            return f"fused(v{factors[0]}, v{factors[1]}, {minus}v{right_operand})"
        return ""
