"""Forms of complementarity, restated as pairs ``0 <= G ⟂ H >= 0``, equations and new variables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np

Graph = Any
"""An expression of CasADi, SX or MX."""
_SAME_DEPTH = 2
"""Depth up to which two expressions are compared."""


@dataclass(frozen=True)
class Relation:
    """Complementarity of expressions (n, 1), entry by entry.

    Two sides a, b are mixed complementarity: ``lower <= b <= upper``, with ``a >= 0`` where b is at its
    lower limit, ``a <= 0`` at its upper one, and ``a = 0`` between. More sides are vertical
    complementarity, ``min(a, b, c, ...) = 0``, without limits.
    """

    sides: tuple[Graph, ...]
    lower: Graph
    upper: Graph
    name: str = "pair"

    @property
    def size(self) -> int:
        """Number of entries n."""
        return int(self.sides[0].numel())


@dataclass
class StandardForm:
    """Relations in standard form: pairs ``G ⟂ H`` (k), equations ``rows = 0`` (r), and new ``variables`` (v).

    ``starts`` are the values of new variables as expressions of the others; ``names`` are those of pairs.
    """

    G: list[ca.SX] = field(default_factory=list)
    H: list[ca.SX] = field(default_factory=list)
    names: list[str] = field(default_factory=list)
    rows: list[ca.SX] = field(default_factory=list)
    variables: list[ca.SX] = field(default_factory=list)
    starts: list[ca.SX] = field(default_factory=list)
    lower: list[float] = field(default_factory=list)

    def add(self, relation: Relation) -> None:
        """Add every entry of a relation whose expressions are SX."""
        single = relation.size == 1
        for i in range(relation.size):
            sides = [ca.SX(side)[i] for side in relation.sides]
            name = relation.name if single else f"{relation.name}[{i}]"
            if len(sides) > 2:
                self.add_vertical(sides, name)
            else:
                self.add_mixed(sides[0], sides[1], (ca.SX(relation.lower)[i], ca.SX(relation.upper)[i]), name)

    def add_mixed(self, a: ca.SX, b: ca.SX, limits: tuple[ca.SX, ca.SX], name: str) -> None:
        """Add ``lower <= b <= upper`` complementary to a.

        With both limits finite ``a = w - v``, ``0 <= w ⟂ b - lower >= 0``, ``0 <= v ⟂ upper - b >= 0``;
        with one finite limit it is a pair, and without limits it is the equation ``a = 0``.
        """
        lower, upper = limits
        has_lower, has_upper = (not (end.is_constant() and np.isinf(float(end))) for end in limits)
        if has_lower and has_upper:
            w, v = (self._variable(part, 0.0) for part in (ca.fmax(a, 0), ca.fmax(-a, 0)))
            self.rows.append(a - w + v)
            self._pair(w, b - lower, f"{name} below")
            self._pair(v, upper - b, f"{name} above")
        elif has_lower:
            self._pair(a, b - lower, name)
        elif has_upper:
            self._pair(-a, upper - b, name)
        else:
            self.rows.append(a)

    def add_vertical(self, sides: Sequence[ca.SX], name: str) -> None:
        """Add ``min(sides) = 0`` as a chain of pairs.

        A new variable t is the minimum of the last two sides a, b, ``0 <= a - t ⟂ b - t >= 0``, and replaces them; this
        is repeated until two sides are left, which form a pair.
        """
        smallest = sides[-1]
        for number, side in enumerate(reversed(sides[1:-1])):
            t = self._variable(ca.fmin(side, smallest), -np.inf)
            self._pair(side - t, smallest - t, f"{name} minimum {number}")
            smallest = t
        self._pair(sides[0], smallest, name)

    def _variable(self, start: ca.SX, lower: float) -> ca.SX:
        """Return a new variable with the given start and lower bound."""
        self.variables.append(ca.SX.sym(f"part_{len(self.variables)}"))
        # Starts are expressions of the problem's own variables, so that they can be evaluated at once.
        self.starts.append(ca.substitute([start], self.variables[:-1], self.starts)[0] if self.starts else start)
        self.lower.append(lower)
        return self.variables[-1]

    def _pair(self, first: ca.SX, second: ca.SX, name: str) -> None:
        """Add the pair ``first ⟂ second`` or, if both are the same expression, the equation ``first = 0``."""
        if ca.is_equal(first, second, _SAME_DEPTH):
            self.rows.append(first)
            return
        self.G.append(first)
        self.H.append(second)
        self.names.append(name)
