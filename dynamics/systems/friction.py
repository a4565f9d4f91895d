"""Time stepping of mechanical systems with Coulomb friction and joint limits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

import casadi as ca

from dynamics.systems.pairs import ContactForces, EnergyBook, Pair
from dynamics.systems.parameters import ParameterTable, Signal
from dynamics.systems.system import ContactSystem, check_shape

Cone = Literal["linearised", "second-order"]


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


@dataclass(frozen=True, eq=False)
class Touching:
    """Contacts of a mechanism, nc of them, and the limits of its joints, nl.

    ``distance(q)`` (nc, 1) [m]; ``sliding(q)`` (nc, nq) the rows J_t with slip velocity J_t v
    [m/s]; ``friction`` Coulomb's coefficient (a scalar, or (nc, 1)), or None for frictionless;
    ``limits(q)`` (nl, 1) the way left to every joint limit; ``names`` those of the contacts,
    ``limit_names`` those of the limits. ``cone`` is how friction's cone is written, see
    :func:`frictional_time_stepping`.
    """

    names: tuple[str, ...]
    distance: Callable[[ca.SX], ca.SX]
    sliding: Callable[[ca.SX], ca.SX] | None = None
    friction: ca.SX | float | None = None
    limits: Callable[[ca.SX], ca.SX] | None = None
    limit_names: tuple[str, ...] = ()
    cone: Cone = "linearised"


@dataclass(eq=False)
class _Rows:
    """Pairs of one step as they are collected: gaps, the impulse's directions, their names."""

    gaps: list[ca.SX] = field(default_factory=list)
    directions: list[ca.SX] = field(default_factory=list)
    signals: list[Signal] = field(default_factory=list)
    pairs: list[Pair] = field(default_factory=list)

    def add(self, kind: str, gap: ca.SX, J: ca.SX, names: list[str], unit: str,
            about: str, first: int = 0) -> None:  # fmt: skip
        self.gaps.append(gap)
        self.directions.append(J)
        self.signals += [Signal(name, unit, about) for name in names]
        self.pairs += [Pair(kind, first + i) for i in range(len(names))]  # pyright: ignore


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
    current q, the usual model, whose true distance may be violated by rotating bodies. ``lam``
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
    rows, forces, lam = _contact_rows(name, touching, x, x_next, h, linearised)
    nothing = ca.SX(nq, nq)
    D = nothing if mechanism.damping is None else mechanism.damping
    K = nothing if mechanism.stiffness is None else mechanism.stiffness
    push = ca.vertcat(ca.SX(0, nq), *rows.directions).T @ lam
    residual = ca.vertcat(
        q_next - q - h * v_next,
        M @ (v_next - v) - smooth + h * (D @ v_next + K @ (q + h * v_next)) - push,
        x_next[2 * nq :] - x[2 * nq :],
    )
    return ContactSystem(
        name=name,
        x=x,
        u=u,
        x_next=x_next,
        lam=lam,
        residual=residual,
        gap=ca.vertcat(ca.SX(0, 1), *rows.gaps),
        states=states,
        inputs=inputs,
        contacts=tuple(rows.signals),
        h=h,
        parameters=parameters,
        phi=_distances(touching, q),
        mu_per_kappa=h,
        citation=citation,
        pairs=tuple(rows.pairs),
        forces=forces,
        book=_book(mechanism, x, u, x_next, lam[: len(touching.names)], forces),
        implicit=True,
        redundant=True,
    )


def _contact_rows(
    name: str, touching: Touching, x: ca.SX, x_next: ca.SX, h: ca.SX | float, linearised: bool
) -> tuple[_Rows, ContactForces | None, ca.SX]:
    q, _, q_next, v_next = _halves(x, x_next)
    nq = q.numel()
    nc, nl = len(touching.names), len(touching.limit_names)
    phi = touching.distance(q)
    check_shape(name, "distance(q)", phi, (nc, 1))
    J = ca.jacobian(phi, q)

    def ahead(distance: Callable[[ca.SX], ca.SX], there: ca.SX) -> ca.SX:
        here = distance(q)
        return here + ca.jacobian(here, q) @ (there - q) if linearised else distance(there)

    rows = _Rows()
    gap, names = ahead(touching.distance, q_next), list(touching.names)
    J_t, f, rough = ca.SX(nc, nq), ca.SX.zeros(nc), False
    if touching.friction is not None and touching.sliding is not None:
        J_t, f, rough = touching.sliding(q), ca.SX.ones(nc) * touching.friction, True
    check_shape(name, "sliding(q)", J_t, (nc, nq))
    second_order = rough and touching.cone == "second-order"
    direction = J - ca.diag(f) @ J_t if second_order else J
    rows.add("normal", gap, direction, names, "N s", "normal impulse")
    if touching.limits is not None:
        way = touching.limits(q)
        check_shape(name, "limits(q)", way, (nl, 1))
        rows.add("limit", ahead(touching.limits, q_next), ca.jacobian(way, q),
                 list(touching.limit_names), "N m s", "impulse of a joint limit", nc)  # fmt: skip
    if not rough:
        return rows, None, ca.SX.sym("lam", nc + nl)
    lam = ca.SX.sym("lam", nc + nl + (2 if second_order else 3) * nc)
    gamma, cone = lam[:nc], ca.vertsplit(lam[nc + nl :], nc)
    add_cone = _second_order_cone if second_order else _linearised_cone
    along = add_cone(rows, touching.names, J_t, h * (J_t @ v_next), f * gamma, cone)
    return rows, ContactForces(touching.names, gamma, along, J_t @ v_next, f), lam


def _linearised_cone(rows: _Rows, names: tuple[str, ...], J_t: ca.SX, slid: ca.SX, bound: ca.SX,
                     cone: list[ca.SX]) -> ca.SX:  # fmt: skip
    """Add beta±, psi to the rows; returns the impulse along the tangents."""
    plus, minus, psi = cone
    for sign, row, gap in (("+", J_t, psi + slid), ("-", -J_t, psi - slid)):
        called = [f"{contact} friction{sign}" for contact in names]
        rows.add("friction", gap, row, called, "N s", "friction impulse")
    slip = [f"{contact} slip" for contact in names]
    rows.add("slip", bound - plus - minus, ca.SX(*J_t.shape), slip, "m", "way slid in a step")
    return plus - minus


def _second_order_cone(rows: _Rows, names: tuple[str, ...], J_t: ca.SX, slid: ca.SX, bound: ca.SX,
                       cone: list[ca.SX]) -> ca.SX:  # fmt: skip
    """Add the eigenvalues ``f gamma ± beta`` of the cone; returns the impulse along the tangents.

    The lower one stands as the gap of the dual's, so that no equation but the pairs is needed.
    """
    upper, dual = cone
    edge = [f"{contact} cone" for contact in names]
    rows.add("friction", dual + 2 * slid, J_t, edge, "N s", "friction impulse above its least")
    slip = [f"{contact} slip" for contact in names]
    rows.add("slip", 2 * bound - upper, ca.SX(*J_t.shape), slip, "m", "twice the way slid back")
    return upper - bound


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
