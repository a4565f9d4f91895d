"""Quasi-dynamic pushing: bodies without momentum, moved by stiffness-controlled actuators."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import casadi as ca

from dynamics.systems.contact_rows import Touching, contact_rows
from dynamics.systems.pairs import ContactForces, Pair
from dynamics.systems.parameters import ParameterTable, Signal
from dynamics.systems.sharp import COULOMB, TRUE_GAPS, Sharp, is_affine
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
    sliding: Callable[[ca.SX], ca.SX] | None = None,
    friction: ca.SX | float | None = None,
    linearised: bool = False,
    load: ca.SX | None = None,
) -> ContactSystem:
    """Quasi-dynamic model of noising, eq. 13, with the transposes it lacks put in.

    ``(1/h) M dq_u = J_u' lam + h load``, ``h K (q_a+ - u) = J_a' lam``, ``gap = phi(q+)``, with
    ``q = (q_u, q_a)`` the unactuated and actuated coordinates, ``dq = q+ - q``, u the commanded
    ``q_a`` [m], ``mass`` M (n_u, n_u) [kg], ``stiffness`` K (n_a, n_a) [N/m], ``lam`` an impulse
    [N s], ``load`` (n_u, 1) [N] a constant force such as weight, none by default.
    ``distance`` maps q to phi [m]. With ``linearised``, as the paper has it, ``gap = phi(q) + J
    dq``: the step is a convex QP, and bodies that turn may cut a corner.

    With ``friction``, Coulomb's coefficients, and ``sliding``, which maps q to the rows J_t (nc,
    nq), each contact has the two rows ``gap ± friction J_t dq``, edges of its friction cone, and
    the impulse ``sum (J ± friction J_t)' lam±``: convex where the gap is, at the price that a
    sliding contact opens at the rate ``friction |J_t dq|``. ``contacts`` name the contacts; the
    pairs are then ``<name>+`` of all contacts and ``<name>-`` of all. The sharpest contact has phi
    at q+ and Coulomb friction with maximum dissipation, as
    :func:`~dynamics.systems.timestepping.time_stepping` writes it.

    As the QP ``min 1/2 dq' P dq - b' dq`` has the unit J s, the log-barrier weight converts as
    ``mu = 1 / kappa``.

    Raises ``ValueError`` where a dimension does not fit.
    """
    nq, nu = len(states), len(inputs)
    x, x_next = ca.SX.sym("x", nq), ca.SX.sym("x_next", nq)
    u, lam = ca.SX.sym("u", nu), ca.SX.sym("lam", len(contacts))
    dq = x_next - x
    n_free, nc = nq - nu, len(contacts)
    phi = distance(x)
    check_shape(name, "mass", mass, (n_free, n_free))
    check_shape(name, "stiffness", stiffness, (nu, nu))
    check_shape(name, "distance(q)", phi, (nc, 1))
    J = ca.jacobian(phi, x)
    ahead = phi + J @ dq if linearised else distance(x_next)
    directions, gaps, forces = [J], [ahead], None
    rubs = sliding is not None and friction is not None
    if sliding is not None and friction is not None:
        J_t, f = sliding(x), ca.SX.ones(nc) * friction
        check_shape(name, "sliding(q)", J_t, (nc, nq))
        slid = f * J_t
        directions, gaps = [J + slid, J - slid], [ahead + slid @ dq, ahead - slid @ dq]
        lam = ca.SX.sym("lam", 2 * nc)
        plus, minus = lam[:nc], lam[nc:]
        names = tuple(contact.name for contact in contacts)
        forces = ContactForces(names, plus + minus, f * (plus - minus), J_t @ dq / h, f)
    weight = ca.SX(n_free, 1) if load is None else load
    check_shape(name, "load", weight, (n_free, 1))

    def residual(impulse: ca.SX) -> ca.SX:
        return ca.vertcat(
            mass @ dq[:n_free] / h - impulse[:n_free] - h * weight,
            h * stiffness @ (x_next[n_free:] - u) - impulse[n_free:],
        )

    def sharpest() -> ContactSystem:
        touching = Touching(contacts, distance, sliding, friction)
        rows = contact_rows(name, touching, x, x_next, dq / h, h)
        return replace(
            system, lam=rows.lam, residual=residual(rows.push), gap=rows.gap, pairs=rows.pairs,
            contacts=rows.signals, forces=rows.forces, sharp=Sharp(),
        )  # fmt: skip

    truer = [TRUE_GAPS] if linearised and not is_affine(phi, x) else []
    sharper = truer + ([COULOMB] if rubs else [])
    system = ContactSystem(
        name=name,
        x=x,
        u=u,
        x_next=x_next,
        lam=lam,
        residual=residual(ca.vertcat(ca.SX(0, nq), *directions).T @ lam),
        gap=ca.vertcat(ca.SX(0, 1), *gaps),
        states=states,
        inputs=inputs,
        contacts=_edges(contacts) if rubs else contacts,
        h=h,
        parameters=parameters,
        phi=phi,
        mu_per_kappa=1.0,
        pairs=tuple(Pair("normal", i) for _ in directions for i in range(nc)),
        forces=forces,
        sharp=Sharp(", ".join(sharper), sharpest) if sharper else Sharp(),
    )
    return system


def _edges(contacts: tuple[Signal, ...]) -> tuple[Signal, ...]:
    """Name the two edges of every contact's friction cone."""
    return tuple(
        Signal(f"{contact.name}{sign}", contact.unit, contact.description)
        for sign in ("+", "-")
        for contact in contacts
    )
