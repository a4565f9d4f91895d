"""How friction's cone is written as complementarity pairs: what every form gets and gives."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import casadi as ca

from dynamics.systems.pairs import Kind
from dynamics.systems.parameters import Signal


class Row(NamedTuple):
    """Pairs of one kind, one for each contact: their gaps, and the directions of their impulses.

    ``gap`` (n, 1), ``direction`` (n, nq), and n ``signals``.
    """

    kind: Kind
    gap: ca.SX
    direction: ca.SX
    signals: list[Signal]


@dataclass(frozen=True, eq=False)
class Rubbing:
    """nc contacts that rub: ``gap`` (nc, 1) [m], rows ``J_n`` and ``J_t`` (nc, nq) along normal and
    tangent, Coulomb's ``friction`` f (nc, 1), and ``slid`` (nc, 1) [m] the way slid in a step.

    ``lam`` are the impulses along the first row's directions and those of the form's own rows.
    """

    contacts: tuple[Signal, ...]
    gap: ca.SX
    J_n: ca.SX
    J_t: ca.SX
    friction: ca.SX
    slid: ca.SX
    lam: list[ca.SX]

    @property
    def rubs(self) -> ca.SX:
        """One, or zero where there is no friction, now or as long as a parameter is zero.

        Without friction the cone has no inside for the path to run in: there the pairs are those of
        a contact with the coefficient 1 which does not slide, and they do not push.
        """
        return ca.if_else(self.friction == 0, 0, 1)

    @property
    def bound(self) -> ca.SX:
        """Largest impulse along the tangent, f gamma (nc, 1) [N s]."""
        return ca.if_else(self.friction == 0, 1, self.friction) * self.lam[0]

    def named(self, what: str, unit: str, description: str) -> list[Signal]:
        """``<contact><what>`` for every contact."""
        return [Signal(f"{c.name}{what}", unit, description) for c in self.contacts]


class ConeForm(NamedTuple):
    """A form of the cone: how many rows it adds to the normal one, and all of them.

    ``pairs`` returns the rows, the normal one first, and the impulses along normal and tangent.
    """

    more: int
    pairs: Callable[[Rubbing], tuple[list[Row], ca.SX, ca.SX]]
