"""Tapes: CasADi SX functions as flat lists of scalar operations."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

import casadi as ca

# Mapping from the number of a CasADi operation to its name.
OP_NAMES: dict[int, str] = {getattr(ca, name): name for name in dir(ca) if name.startswith("OP_") and name.isupper()}

# Operations with two operands.
BINARY = frozenset(
    {
        *(ca.OP_ADD, ca.OP_SUB, ca.OP_MUL, ca.OP_DIV, ca.OP_POW, ca.OP_CONSTPOW),
        *(ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE, ca.OP_AND, ca.OP_OR, ca.OP_IF_ELSE_ZERO),
        *(ca.OP_FMOD, ca.OP_REMAINDER, ca.OP_COPYSIGN, ca.OP_FMIN, ca.OP_FMAX),
        *(ca.OP_ATAN2, ca.OP_HYPOT),
    }
)
# Operations with one operand.
UNARY = frozenset(
    {
        *(ca.OP_NEG, ca.OP_EXP, ca.OP_LOG, ca.OP_SQRT, ca.OP_SQ, ca.OP_TWICE, ca.OP_INV),
        *(ca.OP_SIN, ca.OP_COS, ca.OP_TAN, ca.OP_ASIN, ca.OP_ACOS, ca.OP_ATAN),
        *(ca.OP_SINH, ca.OP_COSH, ca.OP_TANH, ca.OP_ASINH, ca.OP_ACOSH, ca.OP_ATANH),
        *(ca.OP_NOT, ca.OP_FLOOR, ca.OP_CEIL, ca.OP_FABS, ca.OP_SIGN),
        *(ca.OP_ERF, ca.OP_ERFINV, ca.OP_LOG1P, ca.OP_EXPM1),
    }
)
# Operations whose value is their first operand, so that a tape omits them: OP_ASSIGN copies,
# OP_LIFT marks a variable for lifting, OP_PRINTME prints.
RENAMES = frozenset({ca.OP_ASSIGN, ca.OP_LIFT, ca.OP_PRINTME})
# Operations whose result is a truth value.
BOOLEAN = frozenset({ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE, ca.OP_AND, ca.OP_OR, ca.OP_NOT})
# Operations whose operands may be exchanged.
COMMUTATIVE = frozenset({ca.OP_ADD, ca.OP_MUL, ca.OP_EQ, ca.OP_NE, ca.OP_AND, ca.OP_OR, ca.OP_HYPOT})


class UnsupportedOperation(NotImplementedError):
    """Error for a CasADi operation without a scalar form; the message contains the operation and its function."""


@dataclass(frozen=True)
class Operation:
    """One value of a tape: the result of operation `op` on earlier values, an input or a constant.

    `args` are indices of earlier operations; for `OP_INPUT` they are (input, nonzero) instead.
    `value` is the number of an `OP_CONST`, else 0.
    """

    op: int
    args: tuple[int, ...]
    value: float = 0.0


@dataclass(frozen=True)
class Tape:
    """A scalar program in single-assignment form: operation i defines value i.

    `input_sizes` and `output_sizes` count nonzeros; `outputs[k][j]` is the index of the value of
    nonzero j of output k. Equal operations on equal operands occur once.
    """

    name: str
    input_sizes: tuple[int, ...]
    output_sizes: tuple[int, ...]
    operations: tuple[Operation, ...]
    outputs: tuple[tuple[int, ...], ...]

    def use_counts(self) -> list[int]:
        """Return, for each value, the number of operands and outputs that refer to it."""
        counts = [0] * len(self.operations)
        for operation in self.operations:
            for arg in operands_of(operation):
                counts[arg] += 1
        for row in self.outputs:
            for value in row:
                counts[value] += 1
        return counts


def operands_of(operation: Operation) -> tuple[int, ...]:
    """Return the indices of the values that an operation reads, empty for inputs and constants."""
    return () if operation.op == ca.OP_INPUT else operation.args


def selection_of(tape: Tape, operation: Operation) -> tuple[int, int, int] | None:
    """Return the indices (condition, value, other) if an operation is CasADi's `if_else`, else None.

    CasADi writes `if_else` as a sum of two terms, `if_else_zero` of a condition and of its negation.
    """
    if operation.op != ca.OP_ADD:
        return None
    for first, second in (operation.args, operation.args[::-1]):
        first_term, second_term = tape.operations[first], tape.operations[second]
        if first_term.op == second_term.op == ca.OP_IF_ELSE_ZERO:
            condition, negation = first_term.args[0], tape.operations[second_term.args[0]]
            boolean = tape.operations[condition].op in BOOLEAN
            if boolean and negation.op == ca.OP_NOT and negation.args[0] == condition:
                return condition, first_term.args[1], second_term.args[1]
    return None


def share_reciprocals(tape: Tape) -> Tape:
    """Return the tape with repeated divisions by the same value replaced by products with its reciprocal.

    A division takes as long as ten products. The quotient may differ by a rounding error, and is wrong for
    a divisor below 1e-308, whose reciprocal is infinite. Use this function only for graphs in which such divisors
    do not occur.
    """
    divisors = Counter(o.args[1] for o in tape.operations if o.op == ca.OP_DIV)
    operations: list[Operation] = []
    new_index: list[int] = []
    reciprocal: dict[int, int] = {}
    for operation in tape.operations:
        args = operation.args
        if operation.op != ca.OP_INPUT:
            args = tuple(new_index[arg] for arg in args)
        if operation.op == ca.OP_DIV and divisors[operation.args[1]] > 1:
            if args[1] not in reciprocal:
                reciprocal[args[1]] = len(operations)
                operations.append(Operation(ca.OP_INV, (args[1],)))
            operations.append(Operation(ca.OP_MUL, (args[0], reciprocal[args[1]])))
        else:
            operations.append(replace(operation, args=args))
        new_index.append(len(operations) - 1)
    outputs = tuple(tuple(new_index[value] for value in row) for row in tape.outputs)
    return replace(tape, operations=tuple(operations), outputs=outputs)


def tape_of(fn: ca.Function) -> Tape:
    """Flatten a CasADi `Function` (SX, or MX that expands) to a `Tape`.

    Raises `UnsupportedOperation` if the function cannot be written in scalar operations: an MX
    graph that does not expand, a call that is never inlined (`never_inline`), or free variables.
    """
    fn = _as_sx(fn)
    builder = _Builder(fn)
    for i in range(fn.n_instructions()):
        builder.add(i)
    return builder.finish()


def _as_sx(fn: ca.Function) -> ca.Function:
    if fn.has_free():
        raise UnsupportedOperation(f"function '{fn.name()}' has free variables {fn.get_free()}; make them inputs")
    if fn.is_a("SXFunction"):
        return fn
    try:
        return fn.expand()
    except RuntimeError as error:
        reason = str(error).strip().splitlines()[-1]
        raise UnsupportedOperation(
            f"function '{fn.name()}' ({fn.class_name()}) does not expand to scalar operations: {reason}"
        ) from error


class _Builder:
    """Converter of CasADi's register program to single-assignment form, one instruction at a time."""

    def __init__(self, fn: ca.Function) -> None:
        self.fn = fn
        self.operations: list[Operation] = []
        self.index_of: dict[tuple[int, tuple[int, ...], str], int] = {}
        self.register: dict[int, int] = {}
        self.outputs = [[-1] * fn.nnz_out(k) for k in range(fn.n_out())]

    def add(self, i: int) -> None:
        op = self.fn.instruction_id(i)
        source, target = self.fn.instruction_input(i), self.fn.instruction_output(i)
        if op == ca.OP_OUTPUT:
            self.outputs[target[0]][target[1]] = self.register[source[0]]
        elif op == ca.OP_INPUT:
            self.register[target[0]] = self._value(Operation(op, (source[0], source[1])))
        elif op == ca.OP_CONST:
            constant = float(self.fn.instruction_constant(i))
            self.register[target[0]] = self._value(Operation(op, (), constant))
        elif op in RENAMES:
            self.register[target[0]] = self.register[source[0]]
        elif op in UNARY:
            self.register[target[0]] = self._value(Operation(op, (self.register[source[0]],)))
        elif op in BINARY:
            args = (self.register[source[0]], self.register[source[1]])
            self.register[target[0]] = self._value(Operation(op, args))
        else:
            raise UnsupportedOperation(
                f"operation {OP_NAMES.get(op, op)} in function '{self.fn.name()}' "
                "has no scalar form; inline the call or use backend='casadi'"
            )

    def _value(self, operation: Operation) -> int:
        args = operation.args
        if operation.op in COMMUTATIVE:
            args = tuple(sorted(args))
        # float.hex distinguishes 0.0 from -0.0, which == does not.
        key = (operation.op, args, operation.value.hex() if operation.op == ca.OP_CONST else "")
        if key not in self.index_of:
            self.index_of[key] = len(self.operations)
            self.operations.append(operation)
        return self.index_of[key]

    def finish(self) -> Tape:
        fn = self.fn
        return Tape(
            name=fn.name(),
            input_sizes=tuple(fn.nnz_in(k) for k in range(fn.n_in())),
            output_sizes=tuple(fn.nnz_out(k) for k in range(fn.n_out())),
            operations=tuple(self.operations),
            outputs=tuple(tuple(row) for row in self.outputs),
        )
