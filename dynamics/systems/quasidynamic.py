"""Quasi-dynamic pushing: bodies without momentum, moved by stiffness-controlled actuators."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca

from dynamics.systems.contact_rows import Cone, Touching, contact_rows
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
    sliding: Callable[[ca.SX], ca.SX] | None = None,
    friction: ca.SX | float | None = None,
    cone: Cone = "edges",
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

    ``friction`` are Coulomb's coefficients, and ``sliding`` maps q to the rows J_t (nc, nq). With
    the ``cone`` written by its edges each contact has the two rows ``gap ± friction J_t dq``,
    edges of its friction cone, and the impulse ``sum (J ± friction J_t)' lam±``: convex where the
    gap is, at the price that a sliding contact opens at the rate ``friction |J_t dq|``. The pairs
    are then ``<name>+`` of all contacts and ``<name>-`` of all. The sharpest contact has phi at q+
    and Coulomb friction with maximum dissipation, as
    :func:`~dynamics.systems.timestepping.time_stepping` writes it.

    As the QP ``min 1/2 dq' P dq - b' dq`` has the unit J s, the log-barrier weight converts as
    ``mu = 1 / kappa``.

    Raises ``ValueError`` where a dimension does not fit.
    """
    nq, nu = len(states), len(inputs)
    x, x_next, u = ca.SX.sym("x", nq), ca.SX.sym("x_next", nq), ca.SX.sym("u", nu)
    dq, n_free = x_next - x, nq - nu
    weight = ca.SX(n_free, 1) if load is None else load
    check_shape(name, "mass", mass, (n_free, n_free))
    check_shape(name, "stiffness", stiffness, (nu, nu))
    check_shape(name, "load", weight, (n_free, 1))

    def built(touching: Touching) -> ContactSystem:
        rows = contact_rows(name, touching, x, x_next, lambda J: J @ dq, h)
        return ContactSystem(
            name=name,
            x=x,
            u=u,
            x_next=x_next,
            lam=rows.lam,
            residual=ca.vertcat(
                mass @ dq[:n_free] / h - rows.push[:n_free] - h * weight,
                h * stiffness @ (x_next[n_free:] - u) - rows.push[n_free:],
            ),
            gap=rows.gap,
            states=states,
            inputs=inputs,
            contacts=rows.signals,
            h=h,
            parameters=parameters,
            phi=rows.phi,
            mu_per_kappa=1.0,
            pairs=rows.pairs,
            forces=rows.forces,
            sharp=touching.sharp(rows.curved, built),
            mass=mass,
            stiffness=stiffness,
        )

    return built(Touching(contacts, distance, sliding, friction, cone, linearised))
