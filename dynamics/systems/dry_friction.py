"""Bodies that slide on one another under a known normal force."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca

from dynamics.systems.pairs import ContactForces, Pair
from dynamics.systems.parameters import ParameterTable, Signal
from dynamics.systems.sharp import Sharp
from dynamics.systems.system import ContactSystem, check_shape


def dry_friction(
    name: str,
    *,
    states: tuple[Signal, ...],
    inputs: tuple[Signal, ...],
    contact: str,
    h: ca.SX | float,
    mass: ca.SX,
    impulse: Callable[[ca.SX, ca.SX, ca.SX], ca.SX],
    slide: ca.SX,
    load: ca.SX | float,
    friction: ca.SX | float,
    parameters: ParameterTable,
    citation: str = "",
) -> ContactSystem:
    """Time stepping with Coulomb friction at one contact that never opens.

    ``M (v+ - v) = impulse(q, v, u) + J' f`` and ``q+ = q + h v+`` with the friction impulse f
    [N s] of maximal dissipation, ``|f| <= b = friction h load``. The way slid in a step is split,
    ``h J v+ = s_forward - s_backward``, and the pairs are

    ``0 <= s_forward ⟂ b + f >= 0``  and  ``0 <= s_backward ⟂ b - f >= 0``:

    the multipliers are ways [m], the gaps what is left of the friction cone [N s], so lam gap is in
    N s m as everywhere. J = ``slide`` is one row (1, nq), ``load`` > 0 the normal force [N],
    ``mass`` M (nq, nq), ``impulse`` the smooth impulse of a step (nq, 1) [N s]; the state is
    ``(q, v)``. On the central path ``h J v+ = -2 mu f/(b² - f²)``, a barrier on both faces of the
    cone. Two ways instead of two impulses and a way keep the multipliers unique in stick.

    The pairs are those of Li, Gong and Chalvatzaki, IMPACT, arXiv 2605.09127, and of adaptive
    barrier smoothing, fig. 6b. Raises ``ValueError`` where a dimension does not fit.
    """
    nq = len(states) // 2
    x, x_next = ca.SX.sym("x", 2 * nq), ca.SX.sym("x_next", 2 * nq)
    u, lam = ca.SX.sym("u", len(inputs)), ca.SX.sym("lam", 2)
    q, v, q_next, v_next = x[:nq], x[nq:], x_next[:nq], x_next[nq:]
    smooth = impulse(q, v, u)
    check_shape(name, "mass", mass, (nq, nq))
    check_shape(name, "slide", slide, (1, nq))
    check_shape(name, "impulse(q, v, u)", smooth, (nq, 1))
    free = v + ca.solve(mass, smooth)
    compliance = slide @ ca.solve(mass, slide.T)
    f = ((lam[0] - lam[1]) / h - slide @ free) / compliance
    bound = friction * h * load
    return ContactSystem(
        name=name,
        x=x,
        u=u,
        x_next=x_next,
        lam=lam,
        residual=ca.vertcat(q_next - q - h * v_next, mass @ (v_next - free) - slide.T @ f),
        gap=ca.vertcat(bound + f, bound - f),
        states=states,
        inputs=inputs,
        contacts=tuple(
            Signal(f"{contact} {way}", "m", f"way slid {way} in a step")
            for way in ("forward", "backward")
        ),
        h=h,
        parameters=parameters,
        gap_unit="N s",
        citation=citation,
        pairs=(Pair("slip", 0), Pair("slip", 0)),
        forces=ContactForces(
            (contact,), ca.SX(h * load), f, slide @ v_next, ca.SX.ones(1) * friction
        ),
        sharp=Sharp(),
        refinable=True,
    )
