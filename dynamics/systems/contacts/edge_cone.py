"""Friction's cone by its edges, which keeps a step convex."""

from __future__ import annotations

import casadi as ca

from dynamics.systems.contacts.cone import ConeForm, Row, Rubbing
from dynamics.systems.parameters import Signal


def _pairs(at: Rubbing) -> tuple[list[Row], ca.SX, ca.SX]:
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


EDGES = ConeForm(1, _pairs)
