"""Friction's cone as complementarity pairs: by its edges, linearised, or of second order."""

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


def _edge_pairs(at: Rubbing) -> tuple[list[Row], ca.SX, ca.SX]:
    """``lam± ⟂ gap ± f slid``, with the impulse ``sum (J_n ± f J_t)' lam±``.

    At the price that a sliding contact opens at the rate ``f |J_t v|`` (Anitescu, doi
    10.1007/s10107-005-0590-7).
    """
    plus, minus = at.lam
    J_t, slid = ca.diag(at.friction) @ at.J_t, at.friction * at.slid
    rows = []
    for sign, turned, way in (("+", J_t, slid), ("-", -J_t, -slid)):
        named = [Signal(f"{c.name}{sign}", c.unit, c.description) for c in at.contacts]
        rows.append(Row("normal", at.gap + way, at.J_n + turned, named))
    return rows, plus + minus, at.friction * (plus - minus)


EDGES = ConeForm(1, _edge_pairs)


def _linearised_pairs(at: Rubbing) -> tuple[list[Row], ca.SX, ca.SX]:
    """``gamma ⟂ gap``, ``beta± ⟂ psi ± slid`` and ``psi ⟂ f gamma - beta+ - beta-``."""
    gamma, plus, minus, psi = at.lam
    J_t, slid = ca.diag(at.rubs) @ at.J_t, at.rubs * at.slid
    still = ca.SX(*J_t.shape)
    rows = [
        Row("normal", at.gap, at.J_n, list(at.contacts)),
        Row("friction", psi + slid, J_t, at.named(" friction+", "N s", "friction impulse")),
        Row("friction", psi - slid, -J_t, at.named(" friction-", "N s", "friction impulse")),
        Row("slip", at.bound - plus - minus, still, at.named(" slip", "m", "way slid in a step")),
    ]
    return rows, gamma, at.rubs * (plus - minus)


LINEARISED = ConeForm(3, _linearised_pairs)


def _second_order_pairs(at: Rubbing) -> tuple[list[Row], ca.SX, ca.SX]:
    """``gamma ⟂ gap``, ``upper ⟂ dual + 2 slid`` and ``dual ⟂ 2 f gamma - upper``.

    The lower eigenvalue stands as the gap of the dual's, so that no equation but the pairs is
    needed.
    """
    gamma, upper, dual = at.lam
    J_t, slid = ca.diag(at.rubs) @ at.J_t, at.rubs * at.slid
    still = ca.SX(*J_t.shape)
    above = at.named(" cone", "N s", "friction impulse above its least")
    back = at.named(" slip", "m", "twice the way slid back")
    rows = [
        Row("normal", at.gap, at.J_n - ca.diag(at.friction) @ at.J_t, list(at.contacts)),
        Row("friction", dual + 2 * slid, J_t, above),
        Row("slip", 2 * at.bound - upper, still, back),
    ]
    return rows, gamma, at.rubs * (upper - at.bound)


SECOND_ORDER = ConeForm(2, _second_order_pairs)
