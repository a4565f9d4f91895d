"""Taking out of a repeated graph what depends on parameters alone.

Parameters stay the same over a rollout, so an expression in them, such as h/m, is computed once and
handed to the graphs of the step as a value, instead of once a step and sample; a division by such
a value becomes a product with its reciprocal, and a chain of such products one product.
"""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from dynamics.batch.graphs.tape import BINARY, Operation, Tape, tape_of


def hoisted(
    functions: Mapping[str, tuple[ca.Function, int]], n_parameters: int
) -> tuple[ca.Function, dict[str, ca.Function]]:
    """Split functions into what depends on parameters alone and the rest.

    `functions` maps a name to an SX function and the position of its argument p, (n_parameters).
    Returns `derived: p -> q`, and the functions with q in the place of p.
    """
    pool = _Pool(n_parameters)
    split = {
        name: _Split(tape_of(fn), position, pool).results()
        for name, (fn, position) in functions.items()
    }
    q = ca.vertcat(ca.SX(0, 1), *pool.symbols.values())
    values = ca.vertcat(ca.SX(0, 1), *(pool.expressions[i] for i in pool.symbols))
    rest = {}
    for name, (arguments, results) in split.items():
        fn, position = functions[name]
        shaped = [
            ca.reshape(result, fn.size_out(k)) if result.numel() else ca.SX(*fn.size_out(k))
            for k, result in enumerate(results)
        ]
        rest[name] = ca.Function(
            fn.name(), [q if k == position else a for k, a in enumerate(arguments)], shaped
        )
    return ca.Function("derived", [pool.p], [ca.densify(values)]), rest


class _Pool:
    """Expressions in the parameters, each once, whichever function it was found in."""

    def __init__(self, n_parameters: int) -> None:
        self.p = ca.SX.sym("p", n_parameters)
        self.expressions: list[ca.SX] = []
        self.symbols: dict[int, ca.SX] = {}
        self._known: dict[tuple[int, tuple[int, ...], str], int] = {}

    def add(self, operation: Operation, args: tuple[int, ...]) -> int:
        """Index of an operation on earlier members of the pool, or of a parameter or constant."""
        key = (operation.op, args, operation.value.hex())
        if key not in self._known:
            self._known[key] = len(self.expressions)
            self.expressions.append(self._expression(operation, args))
        return self._known[key]

    def _expression(self, operation: Operation, args: tuple[int, ...]) -> ca.SX:
        if operation.op == ca.OP_INPUT:
            return self.p[args[1]]
        if operation.op == ca.OP_CONST:
            return ca.SX(operation.value)
        return apply(operation.op, [self.expressions[i] for i in args])

    def value(self, i: int) -> ca.SX:
        """What the rest of a graph uses for a member: a constant as it is, else a symbol."""
        if self.expressions[i].is_constant():
            return self.expressions[i]
        if i not in self.symbols:
            self.symbols[i] = ca.SX.sym(f"q{len(self.symbols)}")
        return self.symbols[i]


class _Split:
    """One function, with its operations on parameters alone moved to the pool."""

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
                self.pooled[i] = self.pool.add(operation, (0, args[1]))
            else:
                self.values[i] = self.arguments[args[0]][args[1]]
        elif all(arg in self.pooled for arg in args):
            self.pooled[i] = self.pool.add(operation, tuple(self.pooled[arg] for arg in args))
        elif op == ca.OP_DIV and args[1] in self.pooled:
            inverse = self.pool.add(Operation(ca.OP_INV, ()), (self.pooled[args[1]],))
            self._scale(i, args[0], inverse)
        elif op == ca.OP_MUL and args[1] in self.pooled:
            self._scale(i, args[0], self.pooled[args[1]])
        elif op == ca.OP_MUL and args[0] in self.pooled:
            self._scale(i, args[1], self.pooled[args[0]])
        elif op == ca.OP_TWICE:
            self._scale(i, args[0], self.pool.add(Operation(ca.OP_CONST, (), 2.0), ()))
        else:
            self.values[i] = apply(op, [self._value(arg) for arg in args])

    def _scale(self, i: int, of: int, factor: int) -> None:
        if of in self.scaled:
            of, other = self.scaled[of]
            factor = self.pool.add(Operation(ca.OP_MUL, ()), (other, factor))
        self.scaled[i] = of, factor

    def _value(self, i: int) -> ca.SX:
        if i in self.pooled:
            return self.pool.value(self.pooled[i])
        if i not in self.values:
            of, factor = self.scaled[i]
            self.values[i] = self._value(of) * self.pool.value(factor)
        return self.values[i]

    def results(self) -> tuple[list[ca.SX], list[ca.SX]]:
        """Arguments, and each output as a column."""
        outputs = [ca.vertcat(ca.SX(0, 1), *map(self._value, row)) for row in self.tape.outputs]
        return self.arguments, outputs


def apply(op: int, args: list[ca.SX]) -> ca.SX:
    """A scalar operation of CasADi on expressions."""
    return ca.SX.binary(op, *args) if op in BINARY else ca.SX.unary(op, *args)
