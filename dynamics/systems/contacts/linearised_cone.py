"""Friction's cone as a polyhedron, with the way slid as a multiplier of its own."""

from __future__ import annotations

import casadi as ca

from dynamics.systems.contacts.cone import ConeForm, Row, Rubbing


def _pairs(at: Rubbing) -> tuple[list[Row], ca.SX, ca.SX]:
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


LINEARISED = ConeForm(3, _pairs)
