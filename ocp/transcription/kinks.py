"""Kinks of a stage: operations whose operands change order, such as the nearest corner of a body, or ``|x|``."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace

import casadi as ca
import numpy as np

from ocp.transcription.stage import COMPARISONS, ROUNDABLE, Stage

WIDTH = 1e-2
"""Width of a rounded kink, in changes of its margin."""


class Rewriter(ABC):
    """Rewriter of the operations of a graph whose operands move."""

    def rewrite(self, moving: ca.SX, p: ca.SX, outputs: list[ca.SX]) -> list[ca.SX]:
        """Return dense column vectors ``outputs`` in symbols ``moving`` and ``p``, with operations replaced."""
        graph = ca.Function("graph", [moving, p], outputs, {"cse": True})
        arguments = [moving.nz[:], p.nz[:]]
        work, moves = dict[int, ca.SX](), dict[int, bool]()
        results = [ca.SX(output.shape[0], 1) for output in outputs]
        for k in range(graph.n_instructions()):
            code, source, target = graph.instruction_id(k), graph.instruction_input(k), graph.instruction_output(k)
            if code == ca.OP_OUTPUT:
                results[target[0]][target[1]] = work[source[0]]
            elif code == ca.OP_INPUT:
                work[target[0]], moves[target[0]] = arguments[source[0]][source[1]], source[0] == 0
            elif code == ca.OP_CONST:
                work[target[0]], moves[target[0]] = ca.SX(graph.instruction_constant(k)), False
            else:
                operands, is_moving = [work[i] for i in source], any(moves[i] for i in source)
                work[target[0]] = self.operation(code, operands) if is_moving else _plain(code, operands)
                moves[target[0]] = is_moving
        return results

    @abstractmethod
    def operation(self, code: int, operands: list[ca.SX]) -> ca.SX:
        """Return an operation on operands that move."""


@dataclass
class FixedSides(Rewriter):
    """Rewriter that replaces the comparisons of moving numbers by symbols ``sides``.

    For the side 1 of a comparison, ``a < b`` counts as true, for -1 as false, and for 0 numbers decide. ``margins``
    are ``b - a``. Maxima, minima and absolute values are written as comparisons.
    """

    sides: list[ca.SX] = field(default_factory=list)
    margins: list[ca.SX] = field(default_factory=list)
    _by_operands: dict[tuple[int, int], ca.SX] = field(default_factory=dict)

    def operation(self, code: int, operands: list[ca.SX]) -> ca.SX:
        """Return an operation, with a symbol for the side of a comparison."""
        if code in COMPARISONS:
            return self._is_less(operands[0], operands[1], code)
        if code not in ROUNDABLE:
            return _plain(code, operands)
        first, second = _compared(operands)
        smaller = code == ca.OP_FMIN
        return ca.if_else(self._is_less(first, second), first if smaller else second, second if smaller else first)

    def _is_less(self, a: ca.SX, b: ca.SX, code: int = ca.OP_LT) -> ca.SX:
        key = a.element_hash(), b.element_hash()
        if key not in self._by_operands:
            self._by_operands[key] = ca.SX.sym(f"side_{len(self.sides)}")
            self.sides.append(self._by_operands[key])
            self.margins.append(b - a)
        side = self._by_operands[key]
        return ca.logic_or(side > 0, ca.logic_and(side >= 0, _plain(code, [a, b])))


@dataclass
class RoundedKinks(Rewriter):
    """Rewriter that rounds maxima, minima and absolute values by ``widths``: ``max(a, b) = (a + b + r) / 2``.

    ``r = sqrt((b - a)² + width²)`` is rounded ``|b - a|``.
    """

    widths: list[ca.SX] = field(default_factory=list)
    margins: list[ca.SX] = field(default_factory=list)

    def operation(self, code: int, operands: list[ca.SX]) -> ca.SX:
        """Return an operation, rounded if it has a kink."""
        if code not in ROUNDABLE:
            return _plain(code, operands)
        first, second = _compared(operands)
        self.widths.append(ca.SX.sym(f"width_{len(self.widths)}"))
        self.margins.append(second - first)
        rounded = ca.sqrt((second - first) ** 2 + self.widths[-1] ** 2)
        return (first + second + (-rounded if code == ca.OP_FMIN else rounded)) / 2


def _compared(operands: list[ca.SX]) -> tuple[ca.SX, ca.SX]:
    """Return the two operands of a maximum or minimum, and -a and a for ``|a| = max(-a, a)``."""
    return (operands[0], operands[1]) if len(operands) == 2 else (-operands[0], operands[0])


def _plain(code: int, operands: list[ca.SX]) -> ca.SX:
    return ca.SX.binary(code, *operands) if len(operands) == 2 else ca.SX.unary(code, *operands)


def round_kinks(stage: Stage, rows: np.ndarray, sizes: np.ndarray, p: np.ndarray) -> Stage:
    """Return the stage with maxima, minima and absolute values rounded, in its cost and in the constraints ``rows``.

    The width is :data:`WIDTH` times the change of a kink's margin as a local variable changes by its size (nw,),
    where all variables have their sizes and parameters are ``p``.
    """
    rounded, chosen = RoundedKinks(), rows.tolist()
    cost, changed = rounded.rewrite(stage.w, stage.p, [stage.cost, stage.constraints[chosen]])
    if not rounded.widths:
        return stage
    widths, margins = ca.vertcat(*rounded.widths), ca.vertcat(*rounded.margins)
    slopes = ca.Function("slopes", [stage.w, stage.p, widths], [ca.jacobian(margins, stage.w)])
    largest = np.abs(slopes(sizes, p, 0).full() * sizes).max(axis=1)
    constraints = ca.SX(stage.constraints)
    cost, constraints[chosen] = ca.substitute([cost, changed], [widths], [ca.SX(ca.DM(WIDTH * largest))])
    return replace(stage, cost=cost, constraints=constraints, weight=1.0)


def margin_function(stage: Stage) -> ca.Function:
    """Return the function ``(w, p, sizes) -> (margins, changes)`` of a stage with local variables w.

    A kink's change is the largest change of its margin as a variable of w moves by its size.
    """
    kinks = FixedSides()
    kinks.rewrite(stage.w, stage.p, [stage.cost, stage.constraints])
    sizes, zeros = ca.SX.sym("sizes", stage.w.numel()), [ca.SX(0) for _ in kinks.sides]
    margins = ca.vertcat(ca.SX(0, 1), *(ca.substitute(kinks.margins, kinks.sides, zeros) if zeros else []))
    changes = ca.fabs(ca.jacobian(margins, stage.w) * ca.repmat(sizes.T, margins.numel(), 1))
    largest = ca.vertcat(ca.SX(0, 1), *(ca.mmax(changes[i, :]) for i in range(margins.numel())))
    return ca.Function("margins", [stage.w, stage.p, sizes], [ca.densify(margins), ca.densify(largest)])
