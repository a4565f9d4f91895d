"""Implicit steps of mechanical systems with contact: time stepping of Stewart and Trinkle, and quasi-dynamics."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import casadi as ca

from dynamics.systems.checks import require_items, require_positive
from dynamics.systems.contact_rows import Cone, ContactRows, ContactSpec, check_cone, contact_rows
from dynamics.systems.limit_surface import LimitSurface, add_table_friction
from dynamics.systems.pairs import ContactForces, EnergyBalance, Pair, RefereeModel
from dynamics.systems.parameters import ParameterTable, Signal
from dynamics.systems.system import ContactSystem, check_shape

Number = ca.SX | float
PoseFunction = Callable[[ca.SX], ca.SX]
EnergyBalanceFunction = Callable[[ca.SX, ca.SX, ca.SX, ca.SX, ca.SX, ca.SX], EnergyBalance]


def time_stepping(
    name: str,
    *,
    states: tuple[Signal, ...],
    inputs: tuple[Signal, ...],
    contacts: tuple[Signal, ...],
    h: Number,
    mass: PoseFunction | Number,
    impulse: Callable[[ca.SX, ca.SX, ca.SX], ca.SX],
    parameters: ParameterTable,
    distance: PoseFunction | None = None,
    load: Number | None = None,
    sliding: PoseFunction | None = None,
    friction: Number | None = None,
    cone: Cone = "linearised",
    limits: PoseFunction | None = None,
    limit_names: tuple[str, ...] = (),
    damping: ca.SX | None = None,
    stiffness: ca.SX | None = None,
    linearised: bool = False,
    energy_balance: EnergyBalanceFunction | None = None,
) -> ContactSystem:
    """Build a system with Stewart and Trinkle's implicit time stepping, plastic impacts and Coulomb friction.

    ``M(q) (v+ - v) = impulse(q, v, u) - h (D v+ + K q+) + J_n' gamma + J_t' (beta+ - beta-)
    + J_l' nu`` and ``q+ = q + h v+``, with gamma, beta±, nu impulses [N s] and the pairs

    - normal ``0 <= gamma ⟂ phi(q+) >= 0``: no penetration at the next position,
    - limit ``0 <= nu ⟂ limits(q+) >= 0``,
    - friction ``0 <= beta± ⟂ psi ± h J_t v+ >= 0`` and slip ``0 <= psi ⟂ f gamma - beta+ - beta- >=
      0``: maximum dissipation over the linearised cone, psi [m] the distance slid in a step.

    ``lam`` stacks gamma, nu, beta+, beta-, psi in this order. All products lam gap are in N s m, so one mu suits all
    pairs, and if ``distance`` is given, the log-barrier weight converts as ``mu = h / kappa`` (Suh et al. on
    pathologies of differentiable simulators, eq. 2-5). The state is ``(q, v)``, each (nq, 1); if the step size is
    optimised, it is the symbol h, the last entry of the state.

    ``mass`` is M (nq, nq), constant or a function of q; ``impulse`` maps (q, v, u) to the smooth impulse over
    one step (nq, 1) [N s], without the impulse of ``damping`` D and ``stiffness`` K (nq, nq), which act
    implicitly so that steps of stiff joints are stable. For the nc ``contacts``, ``distance`` maps q to phi (nc, 1)
    [m], ``sliding`` to the rows J_t (nc, nq) with slip velocity J_t v [m/s]; ``friction`` is Coulomb's f, a
    scalar or (nc, 1), which may be zero, or None without friction. ``limits`` maps q to the distance from every
    joint limit, ``energy_balance`` maps (q, v, u, v+, gamma, beta+ - beta-) to the
    :class:`~dynamics.systems.EnergyBalance`.

    With ``cone="second-order"`` the friction cone is the second-order cone ``|beta| <= f gamma``, whose barrier
    ``log((f gamma)² - beta²)`` pairs eigenvalues of the cone and of its dual,
    ``(f gamma ± beta) (psi ± h J_t v+) = mu``; in the plane with psi eliminated the two pairs are
    ``upper ⟂ dual + 2 h J_t v+`` and ``dual ⟂ 2 f gamma - upper``, upper = f gamma + beta, dual = psi - h J_t
    v+. At mu = 0 both cones give the same law; their central paths differ.

    With ``cone="edges"`` a step is a convex program if its gaps are affine, but a sliding contact opens, see
    :func:`~dynamics.systems.timestepping.quasi_dynamic`; the most exact model of the system has maximum
    dissipation.

    With ``linearised`` the gaps are linearised at the current q, so that rotating bodies may penetrate; the most
    exact model of the system has the true distances. With ``load`` [N] in place of ``distance`` the contacts
    never open, see :func:`~dynamics.systems.timestepping.pressed_rows`.

    Source: Stewart and Trinkle, doi 10.1002/(SICI)1097-0207(19960815)39:15<2673::AID-NME972>3.0.CO;2-I. Raises
    ``ValueError`` if an argument has the wrong type or a dimension does not fit.
    """
    _check_arguments(name, states, inputs, contacts, h, parameters, cone)
    functions = {"impulse": impulse, "distance": distance, "sliding": sliding, "limits": limits}
    for argument, function in functions.items():
        if not callable(function) and not (function is None and argument != "impulse"):
            raise ValueError(f"system {name!r}: {argument} must be a function, got {function!r}")
    nq, free_step = divmod(len(states), 2)
    x, x_next = ca.SX.sym("x", 2 * nq), ca.SX.sym("x_next", 2 * nq)
    if free_step:
        if not (isinstance(h, ca.SX) and h.is_valid_input()):
            raise ValueError(
                f"system {name!r}: {len(states)} states; expected positions and as many velocities,"
                f" and the step size where h is a symbol, got h = {h}"
            )
        x, x_next = ca.vertcat(x, h), ca.vertcat(x_next, ca.SX.sym("h_next"))
    u = ca.SX.sym("u", len(inputs))
    q, v, q_next, v_next = x[:nq], x[nq : 2 * nq], x_next[:nq], x_next[nq : 2 * nq]
    M, smooth_impulse = ca.SX(mass(q) if callable(mass) else mass), impulse(q, v, u)
    check_shape(name, "mass", M, (nq, nq))
    check_shape(name, "impulse(q, v, u)", smooth_impulse, (nq, 1))
    zero_matrix, nc = ca.SX(nq, nq), len(contacts)
    D, K = (zero_matrix if matrix is None else matrix for matrix in (damping, stiffness))

    def build_from_rows(rows: ContactRows, referee_model: RefereeModel) -> ContactSystem:
        normal = rows.lam[:nc] if rows.forces is None else rows.forces.normal
        tangential = ca.SX.zeros(nc) if rows.forces is None else rows.forces.tangential
        return ContactSystem(
            name=name,
            x=x,
            u=u,
            x_next=x_next,
            lam=rows.lam,
            residual=ca.vertcat(
                q_next - q - h * v_next,
                M @ (v_next - v) - smooth_impulse + h * (D @ v_next + K @ (q + h * v_next)) - rows.generalised_impulse,
                x_next[2 * nq :] - x[2 * nq :],
            ),
            gap=rows.gap,
            states=states,
            inputs=inputs,
            contacts=rows.signals,
            h=h,
            parameters=parameters,
            phi=rows.phi,
            mu_per_kappa=None if rows.phi is None else h,
            gap_unit="N s" if rows.phi is None else "m",
            pairs=rows.pairs,
            forces=rows.forces,
            energy_balance=None if energy_balance is None else energy_balance(q, v, u, v_next, normal, tangential),
            referee_model=referee_model,
            refinable=True,
            mass=M,
        )

    def build_system(touching: ContactSpec) -> ContactSystem:
        rows = contact_rows(name, touching, q, q_next, lambda J: h * (J @ v_next), h)
        return build_from_rows(rows, touching.referee_model(rows.curved, build_system))

    if distance is not None and load is None:
        return build_system(ContactSpec(contacts, distance, sliding, friction, cone, linearised, limits, limit_names))
    if distance is not None or load is None or sliding is None or friction is None:
        raise ValueError(
            f"system {name!r}: give its contacts a distance, or, where they never open, a load with"
            " sliding and friction"
        )
    inertia = M + h * D + h**2 * K
    free = ca.solve(inertia, M @ v + smooth_impulse - h * K @ q)
    slide = sliding(q)
    check_shape(name, "sliding(q)", slide, (nc, nq))
    rows = pressed_rows(contacts, slide, friction, load, inertia, free, v_next, h)
    return build_from_rows(rows, RefereeModel())


def _check_arguments(
    name: str,
    states: tuple[Signal, ...],
    inputs: tuple[Signal, ...],
    contacts: tuple[Signal, ...],
    h: Number,
    parameters: ParameterTable,
    cone: str,
) -> None:
    """Raise ``ValueError`` for a wrong type, a step size that is not positive, or an unknown cone."""
    for argument, signals in (("states", states), ("inputs", inputs), ("contacts", contacts)):
        require_items(f"system {name!r}: {argument}", Signal, signals)
    require_positive(f"system {name!r}: h", h)
    if not isinstance(parameters, ParameterTable):
        raise ValueError(
            f"system {name!r}: parameters must be a ParameterTable, got a"
            f" {type(parameters).__name__}; write ParameterTable([Parameter('m', 1.0, 'kg')])"
        )
    check_cone(name, cone)


def pressed_rows(
    contacts: tuple[Signal, ...],
    slide: ca.SX,
    friction: ca.SX | float,
    load: ca.SX | float,
    inertia: ca.SX,
    free: ca.SX,
    v_next: ca.SX,
    h: ca.SX | float,
) -> ContactRows:
    """Return pairs of Coulomb friction under a known normal load: ``|f| <= b = friction h load``, f [N s].

    The distance slid in a step is split, ``h J v+ = forward - backward``, and the pairs are

    ``0 <= forward ⟂ b + f >= 0``  and  ``0 <= backward ⟂ b - f >= 0``:

    the multipliers are distances [m] and the gaps margins of the friction cone [N s], so ``lam gap`` is in N s
    m as for other pairs. J = ``slide`` (nc, nq), ``load`` > 0 the normal forces [N], a scalar or (nc, 1);
    ``inertia`` A (nq, nq) and ``free`` (nq, 1) give ``v+ = free + A^-1 J' f``. On the central path
    ``h J v+ = -2 mu f/(b² - f²)``, a barrier on both faces of the cone. With two distances, instead of two
    impulses and a distance, the multipliers of a sticking contact are unique.

    The pairs are those of Li, Gong and Chalvatzaki, IMPACT, arXiv 2605.09127, and of adaptive
    barrier smoothing, fig. 6b.
    """
    nc = len(contacts)
    lam = ca.SX.sym("lam", 2 * nc)
    compliance = slide @ ca.solve(inertia, slide.T)
    f = ca.solve(compliance, (lam[:nc] - lam[nc:]) / h - slide @ free)
    bound = ca.SX.ones(nc) * (friction * h * load)
    return ContactRows(
        lam,
        ca.vertcat(bound + f, bound - f),
        slide.T @ f,
        tuple(
            Signal(f"{contact.name} {direction}", "m", f"distance slid {direction} in a step")
            for direction in ("forward", "backward")
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
    tables: Sequence[LimitSurface] = (),
) -> ContactSystem:
    """Build a quasi-dynamic system (Suh et al. on noising contact data, eq. 13, with missing transposes added).

    ``(1/h) M dq_u = J_u' lam + h load``, ``h K (q_a+ - u) = J_a' lam``, ``gap = phi(q+)``, with ``q = (q_u, q_a)``
    the unactuated and actuated coordinates, ``dq = q+ - q``, u the commanded ``q_a`` [m], ``mass`` M (n_u, n_u) [kg],
    ``stiffness`` K (n_a, n_a) [N/m], ``lam`` an impulse [N s], ``load`` (n_u, 1) [N] a constant force such as weight,
    zero by default. ``distance`` maps q to phi [m]. With ``linearised``, as in the paper, ``gap = phi(q) + J dq``:
    the step is a convex QP, and rotating bodies may penetrate.

    ``friction`` are Coulomb's coefficients, and ``sliding`` maps q to the rows J_t (nc, nq). With
    ``cone="edges"`` each contact has the two gaps ``gap ± friction J_t dq``, one for each edge of its
    friction cone, and the impulse ``sum (J ± friction J_t)' lam±``. The step is a convex program if the gap is
    affine, but a sliding contact opens by ``friction |J_t dq|``. The pairs are ``<name>+`` of all contacts, followed
    by ``<name>-`` of all contacts. The most exact model has phi at q+ and Coulomb friction with maximum dissipation,
    see :func:`~dynamics.systems.timestepping.time_stepping`.

    Bodies with a surface in ``tables`` lie on a table and slide on it, see
    :class:`~dynamics.systems.limit_surface.LimitSurface`.

    The objective of the QP ``min 1/2 dq' P dq - b' dq`` has the unit J s, so the log-barrier weight converts as
    ``mu = 1 / kappa``.

    Raises ``ValueError`` if an argument has the wrong type or a dimension does not fit.
    """
    _check_arguments(name, states, inputs, contacts, h, parameters, cone)
    nq, nu = len(states), len(inputs)
    x, x_next, u = ca.SX.sym("x", nq), ca.SX.sym("x_next", nq), ca.SX.sym("u", nu)
    dq, n_free = x_next - x, nq - nu
    weight = ca.SX(n_free, 1) if load is None else load
    check_shape(name, "mass", mass, (n_free, n_free))
    check_shape(name, "stiffness", stiffness, (nu, nu))
    check_shape(name, "load", weight, (n_free, 1))

    def build_system(touching: ContactSpec) -> ContactSystem:
        rows = contact_rows(name, touching, x, x_next, lambda J: J @ dq, h)
        pushed = rows.generalised_impulse[:n_free] + h * weight
        residual = ca.vertcat(
            mass @ dq[:n_free] / h - pushed,
            h * stiffness @ (x_next[n_free:] - u) - rows.generalised_impulse[n_free:],
        )
        if tables:
            rows, residual = add_table_friction(rows, residual, dq[:n_free], pushed, mass, tables, h)
        return ContactSystem(
            name=name,
            x=x,
            u=u,
            x_next=x_next,
            lam=rows.lam,
            residual=residual,
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
            referee_model=touching.referee_model(rows.curved, build_system),
            mass=mass,
            stiffness=stiffness,
        )

    return build_system(ContactSpec(contacts, distance, sliding, friction, cone, linearised))
