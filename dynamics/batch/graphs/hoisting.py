"""Moving of expressions that depend only on parameters out of a graph that is evaluated repeatedly.

Parameters are constant over a rollout, so an expression in them, such as h/m, is computed once, instead of once per
step and sample, and passed to the graphs of the step as a value; a division by such a value becomes a product with
its reciprocal, and a chain of such products becomes one product.
"""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from dynamics.batch.graphs.tape import (
    BINARY,
    COMMUTATIVE,
    Operation,
    Tape,
    operands_of,
    share_reciprocals,
    tape_of,
)


class HoistedFunctions:
    """Functions split into expressions that depend only on parameters p (n_parameters), and the remaining functions."""

    def __init__(self, n_parameters: int) -> None:
        self._pool = _Pool(n_parameters)
        self._split: dict[str, tuple[ca.Function, int, list[ca.SX], list[ca.SX]]] = {}

    def add(self, functions: Mapping[str, tuple[ca.Function, int]]) -> None:
        """Split more functions; `functions` maps a name to an SX function and the position of its argument p."""
        for name, (fn, position) in functions.items():
            self._split[name] = fn, position, *_Split(tape_of(fn), position, self._pool).split_columns()

    def derived(self) -> ca.Function:
        """Return `derived: p -> q`, the expressions that all functions so far take instead of p."""
        values = ca.vertcat(ca.SX(0, 1), *(self._pool.expressions[i] for i in self._pool.symbols))
        return ca.Function("derived", [self._pool.p], [ca.densify(values)])

    def remaining(self) -> dict[str, ca.Function]:
        """Return all functions so far by name, with q in place of p."""
        q = ca.vertcat(ca.SX(0, 1), *self._pool.symbols.values())
        functions = {}
        for name, (fn, position, arguments, results) in self._split.items():
            shaped = [
                ca.reshape(result, fn.size_out(k)) if result.numel() else ca.SX(*fn.size_out(k))
                for k, result in enumerate(results)
            ]
            with_q = [q if k == position else argument for k, argument in enumerate(arguments)]
            functions[name] = ca.Function(fn.name(), with_q, shaped)
        return functions


class _Pool:
    """Pool of the expressions that depend only on parameters, each stored once and shared by all functions."""

    def __init__(self, n_parameters: int) -> None:
        self.p = ca.SX.sym("p", n_parameters)
        self.expressions: list[ca.SX] = []
        self.symbols: dict[int, ca.SX] = {}
        self._index_of: dict[tuple[int, tuple[int, ...], str], int] = {}

    def add_operation(self, operation: Operation, args: tuple[int, ...]) -> int:
        """Add a parameter, a constant or an operation on the pool's members `args`; return the member's index."""
        key = (operation.op, args, operation.value.hex())
        if key not in self._index_of:
            self._index_of[key] = len(self.expressions)
            self.expressions.append(self._expression(operation, args))
        return self._index_of[key]

    def _expression(self, operation: Operation, args: tuple[int, ...]) -> ca.SX:
        if operation.op == ca.OP_INPUT:
            return self.p[args[1]]
        if operation.op == ca.OP_CONST:
            return ca.SX(operation.value)
        return apply_operation(operation.op, [self.expressions[i] for i in args])

    def value(self, i: int) -> ca.SX:
        """Return the constant or the symbol that replaces expression i of the pool in functions of the step."""
        if self.expressions[i].is_constant():
            return self.expressions[i]
        if i not in self.symbols:
            self.symbols[i] = ca.SX.sym(f"q{len(self.symbols)}")
        return self.symbols[i]


class _Split:
    """Split of a function: operations on parameters alone are moved to the ``pool``, and the others remain."""

    def __init__(self, tape: Tape, position: int, pool: _Pool) -> None:
        self.tape, self.position, self.pool = tape, position, pool
        self.arguments = [ca.SX.sym(f"i{k}", n) for k, n in enumerate(tape.input_sizes)]
        self.pooled: dict[int, int] = {}
        self.values: dict[int, ca.SX] = {}
        # Values that are the product of another value and a member of the pool.
        self.scaled: dict[int, tuple[int, int]] = {}
        for i, operation in enumerate(tape.operations):
            self._take(i, operation)

    def _take(self, i: int, operation: Operation) -> None:
        op, args = operation.op, operation.args
        if op == ca.OP_INPUT:
            if args[0] == self.position:
                self.pooled[i] = self.pool.add_operation(operation, (0, args[1]))
            else:
                self.values[i] = self.arguments[args[0]][args[1]]
        elif all(arg in self.pooled for arg in args):
            self.pooled[i] = self.pool.add_operation(operation, tuple(self.pooled[arg] for arg in args))
        elif op == ca.OP_DIV and args[1] in self.pooled:
            inverse = self.pool.add_operation(Operation(ca.OP_INV, ()), (self.pooled[args[1]],))
            self._scale(i, args[0], inverse)
        elif op == ca.OP_MUL and args[1] in self.pooled:
            self._scale(i, args[0], self.pooled[args[1]])
        elif op == ca.OP_MUL and args[0] in self.pooled:
            self._scale(i, args[1], self.pooled[args[0]])
        elif op == ca.OP_TWICE:
            self._scale(i, args[0], self.pool.add_operation(Operation(ca.OP_CONST, (), 2.0), ()))
        else:
            self.values[i] = apply_operation(op, [self._value(arg) for arg in args])

    def _scale(self, i: int, scaled_value: int, factor: int) -> None:
        if scaled_value in self.scaled:
            scaled_value, other = self.scaled[scaled_value]
            factor = self.pool.add_operation(Operation(ca.OP_MUL, ()), (other, factor))
        self.scaled[i] = scaled_value, factor

    def _value(self, i: int) -> ca.SX:
        if i in self.pooled:
            return self.pool.value(self.pooled[i])
        if i not in self.values:
            scaled_value, factor = self.scaled[i]
            self.values[i] = self._value(scaled_value) * self.pool.value(factor)
        return self.values[i]

    def split_columns(self) -> tuple[list[ca.SX], list[ca.SX]]:
        """Return the arguments and outputs of the remaining function, as columns."""
        outputs = [ca.vertcat(ca.SX(0, 1), *map(self._value, row)) for row in self.tape.outputs]
        return self.arguments, outputs


def apply_operation(op: int, args: list[ca.SX]) -> ca.SX:
    """Return the scalar operation with CasADi's number `op`, applied to expressions."""
    return ca.SX.binary(op, *args) if op in BINARY else ca.SX.unary(op, *args)


# Operations that cost more than loading a stored number.
_COSTLY = {
    ca.OP_SQRT,
    ca.OP_DIV,
    ca.OP_INV,
    ca.OP_EXP,
    ca.OP_LOG,
    ca.OP_POW,
    ca.OP_CONSTPOW,
    ca.OP_SIN,
    ca.OP_COS,
    ca.OP_TAN,
    ca.OP_ASIN,
    ca.OP_ACOS,
    ca.OP_ATAN,
    ca.OP_ATAN2,
    ca.OP_SINH,
    ca.OP_COSH,
    ca.OP_TANH,
    ca.OP_ERF,
}


def carry_costly_values(forward: ca.Function, adjoint: ca.Function) -> tuple[ca.Function, ca.Function]:
    """Append to `lam` the divisions, roots and similar values that both functions compute.

    `forward: (x, theta, w, p) -> (x_next, lam, cost)`, `adjoint: (x, theta, w, p, lam, xbar) -> (...)`. In the
    returned functions `lam` ends with these values. The forward step stores them there, and the adjoint reads
    them instead of computing them again, since a division takes as long as ten products, and reading a stored number
    takes one load.
    """
    forward_graph, adjoint_graph = (_Graph(share_reciprocals(tape_of(f))) for f in (forward, adjoint))
    same_in_forward = adjoint_graph.match_values(forward_graph, lam_input=4)
    costly_matches = {i for i in same_in_forward if adjoint_graph.tape.operations[i].op in _COSTLY}
    carried_values = sorted({same_in_forward[i] for i in adjoint_graph.first_met(costly_matches)})
    lam = ca.SX.sym("lam", adjoint.numel_in(4) + len(carried_values))
    replacements = {
        i: lam[adjoint.numel_in(4) + carried_values.index(same_in_forward[i])]
        for i in same_in_forward
        if same_in_forward[i] in carried_values
    }
    arguments = [ca.SX.sym(f"i{k}", n) for k, n in enumerate(forward_graph.tape.input_sizes)]
    values = forward_graph.expressions(arguments, {})
    outputs = forward_graph.outputs(values)
    outputs[1] = ca.vertcat(outputs[1], *(values[i] for i in carried_values))
    xbar = ca.SX.sym("xbar", adjoint.numel_in(5))
    adjoint_outputs = adjoint_graph.outputs(adjoint_graph.expressions([*arguments, lam, xbar], replacements))
    return (
        ca.Function(forward.name(), arguments, outputs),
        ca.Function(adjoint.name(), [*arguments, lam, xbar], adjoint_outputs),
    )


class _Graph:
    """A tape whose values can be matched with the values of another tape."""

    def __init__(self, tape: Tape) -> None:
        self.tape = tape

    def first_met(self, ends: set[int]) -> list[int]:
        """Return the members of ``ends`` that the outputs depend on directly, without another member in between."""
        visited: set[int] = set()
        first_met, pending = [], [i for row in self.tape.outputs for i in row]
        while pending:
            i = pending.pop()
            if i in visited:
                continue
            visited.add(i)
            if i in ends:
                first_met.append(i)
            else:
                pending += operands_of(self.tape.operations[i])
        return first_met

    def match_values(self, other: _Graph, lam_input: int) -> dict[int, int]:
        """Return a mapping from values of this tape to equal values of ``other``.

        Both tapes have the same inputs, except that input ``lam_input`` of this tape is output 1 of ``other``.
        """
        index_by_key = {other._key(op, op.args): i for i, op in enumerate(other.tape.operations)}
        matches: dict[int, int] = {}
        for i, operation in enumerate(self.tape.operations):
            args = operation.args
            if operation.op == ca.OP_INPUT:
                if args[0] == lam_input:
                    matches[i] = other.tape.outputs[1][args[1]]
                    continue
            elif all(arg in matches for arg in args):
                args = tuple(matches[arg] for arg in args)
            else:
                continue
            key = self._key(operation, args)
            if key in index_by_key:
                matches[i] = index_by_key[key]
        return matches

    @staticmethod
    def _key(operation: Operation, args: tuple[int, ...]) -> tuple[int, tuple[int, ...], float]:
        ordered = tuple(sorted(args)) if operation.op in COMMUTATIVE else args
        return operation.op, ordered, operation.value

    def expressions(self, arguments: list[ca.SX], replacements: dict[int, ca.SX]) -> list[ca.SX]:
        """Return every value as an expression in ``arguments``; ``replacements`` maps indices to values to use."""
        values: list[ca.SX] = []
        for i, operation in enumerate(self.tape.operations):
            if i in replacements:
                values.append(replacements[i])
            elif operation.op == ca.OP_INPUT:
                values.append(arguments[operation.args[0]][operation.args[1]])
            elif operation.op == ca.OP_CONST:
                values.append(ca.SX(operation.value))
            else:
                values.append(apply_operation(operation.op, [values[arg] for arg in operation.args]))
        return values

    def outputs(self, values: list[ca.SX]) -> list[ca.SX]:
        """Return the tape's outputs as columns, given the expressions of all values."""
        return [ca.vertcat(ca.SX(0, 1), *(values[i] for i in row)) for row in self.tape.outputs]
