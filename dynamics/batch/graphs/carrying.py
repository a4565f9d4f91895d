"""Handing costly values of the forward step to its adjoint, instead of computing them twice."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca

from dynamics.batch.graphs.hoisting import apply
from dynamics.batch.graphs.tape import (
    COMMUTATIVE,
    Operation,
    Tape,
    operands,
    tape_of,
    with_shared_reciprocals,
)

_COSTLY = {
    ca.OP_SQRT, ca.OP_DIV, ca.OP_INV, ca.OP_EXP, ca.OP_LOG, ca.OP_POW, ca.OP_CONSTPOW, ca.OP_SIN,
    ca.OP_COS, ca.OP_TAN, ca.OP_ASIN, ca.OP_ACOS, ca.OP_ATAN, ca.OP_ATAN2, ca.OP_SINH, ca.OP_COSH,
    ca.OP_TANH, ca.OP_ERF,
}  # fmt: skip


def carried(forward: ca.Function, adjoint: ca.Function) -> tuple[ca.Function, ca.Function]:
    """Let `lam` carry the divisions, roots and the like that both functions compute.

    `forward: (x, theta, w, p) -> (x_next, lam, cost)`, `adjoint: (x, theta, w, p, lam, xbar) ->
    (...)`. In what is returned lam is longer by those values of the forward step, which the adjoint
    reads instead: a division takes a processor as long as ten products, a stored number one load.
    """
    first, second = (_Graph(with_shared_reciprocals(tape_of(f))) for f in (forward, adjoint))
    same = second.matched(first, lam_input=4)
    kept = sorted({same[i] for i in second.needed(lambda i: i in same and second.costly(i))})
    lam = ca.SX.sym("lam", adjoint.numel_in(4) + len(kept))
    given = {i: lam[adjoint.numel_in(4) + kept.index(same[i])] for i in same if same[i] in kept}
    arguments = [ca.SX.sym(f"i{k}", n) for k, n in enumerate(first.tape.input_sizes)]
    values = first.expressions(arguments, {})
    outputs = first.outputs(values)
    outputs[1] = ca.vertcat(outputs[1], *(values[i] for i in kept))
    xbar = ca.SX.sym("xbar", adjoint.numel_in(5))
    bars = second.outputs(second.expressions([*arguments, lam, xbar], given))
    return (
        ca.Function(forward.name(), arguments, outputs),
        ca.Function(adjoint.name(), [*arguments, lam, xbar], bars),
    )


class _Graph:
    """A tape whose values can be found in another tape."""

    def __init__(self, tape: Tape) -> None:
        self.tape = tape

    def costly(self, i: int) -> bool:
        return self.tape.operations[i].op in _COSTLY

    def needed(self, ends: Callable[[int], bool]) -> list[int]:
        """Values at which ``ends`` holds, met first on the way from the outputs down."""
        seen: set[int] = set()
        found, pending = [], [i for row in self.tape.outputs for i in row]
        while pending:
            i = pending.pop()
            if i in seen:
                continue
            seen.add(i)
            if ends(i):
                found.append(i)
            else:
                pending += operands(self.tape.operations[i])
        return found

    def matched(self, other: _Graph, lam_input: int) -> dict[int, int]:
        """Which value of ``other`` a value of this tape is; inputs agree but for ``lam_input``,
        which is the other's output 1."""
        known = {other._key(op, op.args): i for i, op in enumerate(other.tape.operations)}
        found: dict[int, int] = {}
        for i, operation in enumerate(self.tape.operations):
            args = operation.args
            if operation.op == ca.OP_INPUT:
                if args[0] == lam_input:
                    found[i] = other.tape.outputs[1][args[1]]
                    continue
            elif all(arg in found for arg in args):
                args = tuple(found[arg] for arg in args)
            else:
                continue
            key = self._key(operation, args)
            if key in known:
                found[i] = known[key]
        return found

    @staticmethod
    def _key(operation: Operation, args: tuple[int, ...]) -> tuple[int, tuple[int, ...], float]:
        ordered = tuple(sorted(args)) if operation.op in COMMUTATIVE else args
        return operation.op, ordered, operation.value

    def expressions(self, arguments: list[ca.SX], given: dict[int, ca.SX]) -> list[ca.SX]:
        """Every value as an expression in ``arguments``, or as it is ``given``."""
        values: list[ca.SX] = []
        for i, operation in enumerate(self.tape.operations):
            if i in given:
                values.append(given[i])
            elif operation.op == ca.OP_INPUT:
                values.append(arguments[operation.args[0]][operation.args[1]])
            elif operation.op == ca.OP_CONST:
                values.append(ca.SX(operation.value))
            else:
                values.append(apply(operation.op, [values[arg] for arg in operation.args]))
        return values

    def outputs(self, values: list[ca.SX]) -> list[ca.SX]:
        """The tape's outputs as columns."""
        return [ca.vertcat(ca.SX(0, 1), *(values[i] for i in row)) for row in self.tape.outputs]
