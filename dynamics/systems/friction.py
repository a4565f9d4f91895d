"""Time stepping of mechanical systems with Coulomb friction and joint limits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca

from dynamics.systems.contact_rows import Touching, contact_rows
from dynamics.systems.pairs import ContactForces, EnergyBook
from dynamics.systems.parameters import ParameterTable, Signal
from dynamics.systems.sharp import TRUE_GAPS, Sharp, is_affine, with_gap
from dynamics.systems.system import ContactSystem, check_shape


@dataclass(frozen=True, eq=False)
class Mechanism:
    """A mechanical system before contact, in coordinates q (nq, 1), all CasADi expressions.

    ``mass(q)`` (nq, nq); ``impulse(q, v, u)`` (nq, 1) [N s] the smooth impulse of one step but for
    ``damping`` D (nq, nq) [N s/m] and ``stiffness`` K (nq, nq) [N/m], which act implicitly,
    ``-h (D v+ + K q+)``: stiff joints stay stable. Where they are known: ``energy(q, v)`` [J],
    ``work(u, v_next)`` [J] of motors and dampers over one step, ``momentum(q, v)`` (2, 1) [N s] and
    ``external(v_next, normal, tangential)`` (2, 1) [N s] the impulse of everything outside.
    """

    mass: Callable[[ca.SX], ca.SX]
    impulse: Callable[[ca.SX, ca.SX, ca.SX], ca.SX]
    damping: ca.SX | None = None
    stiffness: ca.SX | None = None
    energy: Callable[[ca.SX, ca.SX], ca.SX] | None = None
    work: Callable[[ca.SX, ca.SX], ca.SX] | None = None
    momentum: Callable[[ca.SX, ca.SX], ca.SX] | None = None
    external: Callable[[ca.SX, ca.SX, ca.SX], ca.SX] | None = None


def frictional_time_stepping(
    name: str,
    *,
    states: tuple[Signal, ...],
    inputs: tuple[Signal, ...],
    mechanism: Mechanism,
    touching: Touching,
    h: ca.SX | float,
    parameters: ParameterTable,
    linearised: bool = False,
    citation: str = "",
) -> ContactSystem:
    """Implicit time stepping of Stewart and Trinkle with Coulomb friction in the plane.

    ``M(q) (v+ - v) = impulse(q, v, u) - h (D v+ + K q+) + J_n' gamma + J_t' (beta+ - beta-)
    + J_l' nu`` and ``q+ = q + h v+``, with gamma, beta±, nu impulses [N s] and the pairs

    - normal ``0 <= gamma ⟂ phi(q+) >= 0``: no penetration at the next position, plastic impacts,
    - friction ``0 <= beta± ⟂ psi ± h J_t v+ >= 0`` and slip ``0 <= psi ⟂ f gamma - beta+ - beta- >=
      0``: maximum dissipation over the linearised cone, psi [m] the way slid in a step,
    - limit ``0 <= nu ⟂ limits(q+) >= 0``.

    With ``cone="second-order"`` friction is that of the second-order cone ``|beta| <= f gamma``,
    whose barrier ``log((f gamma)² - beta²)`` pairs eigenvalues of the cone and of its dual,
    ``(f gamma ± beta) (psi ± h J_t v+) = mu``; in the plane with psi eliminated the two pairs are
    ``upper ⟂ dual + 2 h J_t v+`` and ``dual ⟂ 2 f gamma - upper``, upper = f gamma + beta, dual =
    psi - h J_t v+. At mu = 0 both cones are the same law; their central paths differ.

    All products are in N s m, so one mu suits all. With ``linearised`` the gaps are expanded at the
    current q, the usual model, whose true distance may be violated by rotating bodies; its sharpest
    contact is that without. ``lam``
    holds gamma, nu, beta+, beta-, psi (or upper, dual) in this order. The state is ``(q, v)``, each
    (nq, 1); where the step size is to be chosen, one state more: h, a symbol that never changes.

    Stewart and Trinkle, doi 10.1002/(SICI)1097-0207(19960815)39:15<2673::AID-NME972>3.0.CO;2-I.
    Raises ``ValueError`` where a dimension does not fit.
    """
    nq, free_step = divmod(len(states), 2)
    x, x_next = ca.SX.sym("x", 2 * nq), ca.SX.sym("x_next", 2 * nq)
    if free_step:
        if not (isinstance(h, ca.SX) and h.is_valid_input()):
            raise ValueError(
                f"system {name!r}: {len(states)} states are positions, as many velocities and the"
                f" step size; h must then be a symbol, got {h}"
            )
        x, x_next = ca.vertcat(x, h), ca.vertcat(x_next, ca.SX.sym("h_next"))
    u = ca.SX.sym("u", len(inputs))
    q, v, q_next, v_next = _halves(x, x_next)
    M, smooth = mechanism.mass(q), mechanism.impulse(q, v, u)
    check_shape(name, "mass(q)", M, (nq, nq))
    check_shape(name, "impulse(q, v, u)", smooth, (nq, 1))
    rows = contact_rows(name, touching, q, q_next, v_next, h, linearised)
    nothing = ca.SX(nq, nq)
    D = nothing if mechanism.damping is None else mechanism.damping
    K = nothing if mechanism.stiffness is None else mechanism.stiffness
    residual = ca.vertcat(
        q_next - q - h * v_next,
        M @ (v_next - v) - smooth + h * (D @ v_next + K @ (q + h * v_next)) - rows.push,
        x_next[2 * nq :] - x[2 * nq :],
    )
    phi = _distances(touching, q)

    def with_true_gaps() -> ContactSystem:
        tail = rows.gap[phi.numel() :, :]
        return with_gap(system, ca.vertcat(_distances(touching, q_next), tail), redundant=True)

    truer = linearised and not is_affine(phi, q)
    system = ContactSystem(
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
        phi=phi,
        mu_per_kappa=h,
        citation=citation,
        pairs=rows.pairs,
        forces=rows.forces,
        book=_book(mechanism, x, u, x_next, rows.lam[: len(touching.names)], rows.forces),
        redundant=True,
        sharp=Sharp(TRUE_GAPS, with_true_gaps) if truer else Sharp(),
        refinable=True,
    )
    return system


def _halves(x: ca.SX, x_next: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
    """``q, v, q_next, v_next``."""
    nq = x.numel() // 2
    return x[:nq], x[nq : 2 * nq], x_next[:nq], x_next[nq : 2 * nq]


def _distances(touching: Touching, q: ca.SX) -> ca.SX:
    parts = [touching.distance(q), *([] if touching.limits is None else [touching.limits(q)])]
    return ca.vertcat(*parts)


def _book(
    m: Mechanism, x: ca.SX, u: ca.SX, x_next: ca.SX, gamma: ca.SX, forces: ContactForces | None
) -> EnergyBook | None:
    q, v, _, v_next = _halves(x, x_next)
    if m.energy is None or m.work is None or m.momentum is None or m.external is None:
        return None
    along = ca.SX.zeros(gamma.numel()) if forces is None else forces.tangential
    external = m.external(v_next, gamma, along)
    return EnergyBook(m.energy(q, v), m.work(u, v_next), m.momentum(q, v), external)
