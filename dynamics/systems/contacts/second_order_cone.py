"""Friction's second-order cone, by its eigenvalues and those of its dual."""

from __future__ import annotations

import casadi as ca

from dynamics.systems.contacts.cone import ConeForm, Row, Rubbing


def _pairs(at: Rubbing) -> tuple[list[Row], ca.SX, ca.SX]:
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


SECOND_ORDER = ConeForm(2, _pairs)
