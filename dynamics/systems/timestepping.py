"""Velocity-level time stepping of a mechanical system with unilateral contact."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca

from dynamics.systems.parameters import ParameterTable, Signal
from dynamics.systems.sharp import TRUE_GAPS, Sharp, is_affine, with_gap
from dynamics.systems.system import ContactSystem, check_shape


def time_stepping(
    name: str,
    *,
    states: tuple[Signal, ...],
    inputs: tuple[Signal, ...],
    contacts: tuple[Signal, ...],
    h: ca.SX | float,
    mass: ca.SX,
    impulse: Callable[[ca.SX, ca.SX, ca.SX], ca.SX],
    distance: Callable[[ca.SX], ca.SX],
    parameters: ParameterTable,
    citation: str = "",
) -> ContactSystem:
    """Implicit time stepping of Stewart and Trinkle, plastic impacts.

    ``M (v+ - v) = impulse(q, v, u) + J' lam``, ``q+ = q + h v+``,
    ``gap = phi(q) + J (q+ - q)`` with ``J = d phi / d q`` at the current q, which equals
    ``phi(q+)`` where phi is affine. The state is ``(q, v)``, each (nq, 1); ``lam`` is an impulse
    [N s], ``impulse`` the smooth impulse over one step [N s], ``distance`` maps q to phi [m].

    With gap = phi(q+) [m] the log-barrier weight converts as ``mu = h / kappa``
    (pathologies, eq. 2-5). Its sharpest contact has ``gap = phi(q+)``.

    Raises ``ValueError`` where a dimension does not fit.
    """
    if len(states) % 2:
        raise ValueError(
            f"system {name!r}: {len(states)} states; expected positions and as many velocities"
        )
    nq = len(states) // 2
    x, x_next = ca.SX.sym("x", 2 * nq), ca.SX.sym("x_next", 2 * nq)
    u, lam = ca.SX.sym("u", len(inputs)), ca.SX.sym("lam", len(contacts))
    q, v, q_next, v_next = x[:nq], x[nq:], x_next[:nq], x_next[nq:]
    phi, smooth = distance(q), impulse(q, v, u)
    check_shape(name, "mass", mass, (nq, nq))
    check_shape(name, "impulse(q, v, u)", smooth, (nq, 1))
    check_shape(name, "distance(q)", phi, (len(contacts), 1))
    J = ca.jacobian(phi, q)
    residual = ca.vertcat(
        q_next - q - h * v_next,
        mass @ (v_next - v) - smooth - J.T @ lam,
    )

    def with_true_gaps() -> ContactSystem:
        return with_gap(system, distance(q_next), redundant=len(contacts) > nq)

    system = ContactSystem(
        name=name,
        x=x,
        u=u,
        x_next=x_next,
        lam=lam,
        residual=residual,
        gap=phi + J @ (q_next - q),
        states=states,
        inputs=inputs,
        contacts=contacts,
        h=h,
        parameters=parameters,
        phi=phi,
        mu_per_kappa=h,
        citation=citation,
        sharp=Sharp() if is_affine(phi, q) else Sharp(TRUE_GAPS, with_true_gaps),
        refinable=True,
    )
    return system
