"""Quasi-dynamic pushing: bodies without momentum, moved by stiffness-controlled actuators."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca

from dynamics.systems.parameters import ParameterTable, Signal
from dynamics.systems.system import ContactSystem, check_shape


def quasi_dynamic(
    name: str,
    *,
    states: tuple[Signal, ...],
    inputs: tuple[Signal, ...],
    contacts: tuple[Signal, ...],
    h: ca.SX | float,
    mass: ca.SX,
    stiffness: ca.SX,
    distance: Callable[[ca.SX], ca.SX],
    parameters: ParameterTable,
    citation: str = "",
) -> ContactSystem:
    """Quasi-dynamic model of noising, eq. 13, with the transposes it lacks put in.

    ``(1/h) M dq_u = J_u' lam``, ``h K (q_a+ - u) = J_a' lam``, ``gap = phi(q) + J dq``, with
    ``q = (q_u, q_a)`` the unactuated and actuated coordinates, ``dq = q+ - q``, u the commanded
    ``q_a`` [m], ``mass`` M (n_u, n_u) [kg], ``stiffness`` K (n_a, n_a) [N/m], ``lam`` an impulse
    [N s]. Non-penetration is linearised at the current q; ``distance`` maps q to phi [m].

    As the QP ``min 1/2 dq' P dq - b' dq`` has the unit J s, the log-barrier weight converts as
    ``mu = 1 / kappa``.

    Raises ``ValueError`` where a dimension does not fit.
    """
    nq, nu = len(states), len(inputs)
    x, x_next = ca.SX.sym("x", nq), ca.SX.sym("x_next", nq)
    u, lam = ca.SX.sym("u", nu), ca.SX.sym("lam", len(contacts))
    dq = x_next - x
    n_free = nq - nu
    phi = distance(x)
    check_shape(name, "mass", mass, (n_free, n_free))
    check_shape(name, "stiffness", stiffness, (nu, nu))
    check_shape(name, "distance(q)", phi, (len(contacts), 1))
    J = ca.jacobian(phi, x)
    impulse = J.T @ lam
    residual = ca.vertcat(
        mass @ dq[:n_free] / h - impulse[:n_free],
        h * stiffness @ (x_next[n_free:] - u) - impulse[n_free:],
    )
    return ContactSystem(
        name=name,
        x=x,
        u=u,
        x_next=x_next,
        lam=lam,
        residual=residual,
        gap=phi + J @ dq,
        states=states,
        inputs=inputs,
        contacts=contacts,
        h=h,
        parameters=parameters,
        phi=phi,
        mu_per_kappa=1.0,
        citation=citation,
    )
