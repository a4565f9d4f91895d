"""The complementarity pairs of contacts that never open, pressed by a known normal force."""

from __future__ import annotations

import casadi as ca

from dynamics.systems.contact_rows import ContactRows
from dynamics.systems.pairs import ContactForces, Pair
from dynamics.systems.parameters import Signal
from dynamics.systems.system import check_shape


def pressed_rows(
    name: str,
    contacts: tuple[Signal, ...],
    slide: ca.SX,
    friction: ca.SX | float,
    load: ca.SX | float,
    inertia: ca.SX,
    free: ca.SX,
    v_next: ca.SX,
    h: ca.SX | float,
) -> ContactRows:
    """Coulomb friction of maximal dissipation, ``|f| <= b = friction h load``, f [N s].

    The way slid in a step is split, ``h J v+ = forward - backward``, and the pairs are

    ``0 <= forward ⟂ b + f >= 0``  and  ``0 <= backward ⟂ b - f >= 0``:

    the multipliers are ways [m], the gaps what is left of the friction cone [N s], so lam gap is in
    N s m as everywhere. J = ``slide`` (nc, nq), ``load`` > 0 the normal forces [N], a scalar or
    (nc, 1); ``inertia`` A (nq, nq) and ``free`` (nq, 1) give ``v+ = free + A^-1 J' f``. On the
    central path ``h J v+ = -2 mu f/(b² - f²)``, a barrier on both faces of the cone. Two ways
    instead of two impulses and a way keep the multipliers unique in stick.

    The pairs are those of Li, Gong and Chalvatzaki, IMPACT, arXiv 2605.09127, and of adaptive
    barrier smoothing, fig. 6b. Raises ``ValueError`` where a dimension does not fit.
    """
    nc = len(contacts)
    check_shape(name, "sliding(q)", slide, (nc, inertia.shape[0]))
    lam = ca.SX.sym("lam", 2 * nc)
    compliance = slide @ ca.solve(inertia, slide.T)
    f = ca.solve(compliance, (lam[:nc] - lam[nc:]) / h - slide @ free)
    bound = ca.SX.ones(nc) * (friction * h * load)
    return ContactRows(
        lam,
        ca.vertcat(bound + f, bound - f),
        slide.T @ f,
        tuple(
            Signal(f"{contact.name} {way}", "m", f"way slid {way} in a step")
            for way in ("forward", "backward")
            for contact in contacts
        ),
        tuple(Pair("slip", i) for _ in range(2) for i in range(nc)),
        ContactForces(
            tuple(contact.name for contact in contacts),
            ca.SX.ones(nc) * (h * load),
            f,
            slide @ v_next,
            ca.SX.ones(nc) * friction,
        ),
    )
