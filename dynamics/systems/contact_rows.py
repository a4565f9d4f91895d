"""The complementarity pairs of contacts with Coulomb friction, and of the limits of joints."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Literal

import casadi as ca

from dynamics.systems.pairs import ContactForces, Kind, Pair
from dynamics.systems.parameters import Signal
from dynamics.systems.system import check_shape

Cone = Literal["linearised", "second-order"]


@dataclass(frozen=True, eq=False)
class Touching:
    """Contacts of a mechanism, nc of them, and the limits of its joints, nl.

    As the arguments of :func:`~dynamics.systems.timestepping.time_stepping` of these names.
    """

    contacts: tuple[Signal, ...]
    distance: Callable[[ca.SX], ca.SX]
    sliding: Callable[[ca.SX], ca.SX] | None = None
    friction: ca.SX | float | None = None
    limits: Callable[[ca.SX], ca.SX] | None = None
    limit_names: tuple[str, ...] = ()
    cone: Cone = "linearised"

    def distances(self, q: ca.SX) -> ca.SX:
        """Distances of the contacts and ways to the limits, (nc + nl, 1)."""
        return ca.vertcat(self.distance(q), *([] if self.limits is None else [self.limits(q)]))


@dataclass(frozen=True, eq=False)
class ContactRows:
    """The pairs of one step: ``lam`` (nlam, 1), ``gap`` (nlam, 1), and ``push`` (nq, 1) their
    generalised impulse [N s]; ``signals`` and ``pairs`` say what each is, ``forces`` what they add
    up to, None where there is no friction.
    """

    lam: ca.SX
    gap: ca.SX
    push: ca.SX
    signals: tuple[Signal, ...]
    pairs: tuple[Pair, ...]
    forces: ContactForces | None


@dataclass(eq=False)
class _Rows:
    """Pairs of one step as they are collected: gaps, the impulse's directions, their names."""

    gaps: list[ca.SX] = field(default_factory=list)
    directions: list[ca.SX] = field(default_factory=list)
    signals: list[Signal] = field(default_factory=list)
    pairs: list[Pair] = field(default_factory=list)

    def add(self, kind: Kind, gap: ca.SX, J: ca.SX, signals: Iterable[Signal],
            first: int = 0) -> None:  # fmt: skip
        self.gaps.append(gap)
        self.directions.append(J)
        for i, signal in enumerate(signals):
            self.signals.append(signal)
            self.pairs.append(Pair(kind, first + i))

    def closed(self, lam: ca.SX, nq: int, forces: ContactForces | None) -> ContactRows:
        push = ca.vertcat(ca.SX(0, nq), *self.directions).T @ lam
        gap = ca.vertcat(ca.SX(0, 1), *self.gaps)
        return ContactRows(lam, gap, push, tuple(self.signals), tuple(self.pairs), forces)


def contact_rows(
    name: str,
    touching: Touching,
    q: ca.SX,
    q_next: ca.SX,
    v_next: ca.SX,
    h: ca.SX | float,
    linearised: bool = False,
) -> ContactRows:
    """Write the pairs of ``touching`` for a step of h from q to q_next at the velocity v_next.

    They are those of :func:`~dynamics.systems.timestepping.time_stepping`, in its order;
    with ``linearised`` the gaps are expanded at q. A contact whose friction is zero, now or as long
    as a parameter is zero, has its pairs too, but they neither see its slip nor push.

    Raises ``ValueError`` where a dimension does not fit.
    """
    nq, nc, nl = q.numel(), len(touching.contacts), len(touching.limit_names)
    phi = touching.distance(q)
    check_shape(name, "distance(q)", phi, (nc, 1))
    J = ca.jacobian(phi, q)

    def ahead(distance: Callable[[ca.SX], ca.SX], there: ca.SX) -> ca.SX:
        here = distance(q)
        return here + ca.jacobian(here, q) @ (there - q) if linearised else distance(there)

    rows = _Rows()
    gap = ahead(touching.distance, q_next)
    J_t, f, rough = ca.SX(nc, nq), ca.SX.zeros(nc), False
    if touching.friction is not None and touching.sliding is not None:
        J_t, f, rough = touching.sliding(q), ca.SX.ones(nc) * touching.friction, True
    check_shape(name, "sliding(q)", J_t, (nc, nq))
    second_order = rough and touching.cone == "second-order"
    direction = J - ca.diag(f) @ J_t if second_order else J
    rows.add("normal", gap, direction, touching.contacts)
    if touching.limits is not None:
        way = touching.limits(q)
        check_shape(name, "limits(q)", way, (nl, 1))
        stops = [Signal(n, "N m s", "impulse of a joint limit") for n in touching.limit_names]
        rows.add("limit", ahead(touching.limits, q_next), ca.jacobian(way, q), stops, nc)
    if not rough:
        return rows.closed(ca.SX.sym("lam", nc + nl), nq, None)
    lam = ca.SX.sym("lam", nc + nl + (2 if second_order else 3) * nc)
    gamma, cone = lam[:nc], ca.vertsplit(lam[nc + nl :], nc)
    # Without friction the cone has no inside for the path to run in: there the pairs are those of
    # a contact with the coefficient 1 which does not slide.
    rubs = ca.if_else(f == 0, 0, 1)
    wide = ca.if_else(f == 0, 1, f) * gamma
    add_cone = _second_order_cone if second_order else _linearised_cone
    slid = rubs * (h * (J_t @ v_next))
    names = tuple(contact.name for contact in touching.contacts)
    along = rubs * add_cone(rows, names, ca.diag(rubs) @ J_t, slid, wide, cone)
    forces = ContactForces(names, gamma, along, J_t @ v_next, f)
    return rows.closed(lam, nq, forces)


def _linearised_cone(rows: _Rows, names: tuple[str, ...], J_t: ca.SX, slid: ca.SX, bound: ca.SX,
                     cone: list[ca.SX]) -> ca.SX:  # fmt: skip
    """Add beta±, psi to the rows; returns the impulse along the tangents."""
    plus, minus, psi = cone
    for sign, row, gap in (("+", J_t, psi + slid), ("-", -J_t, psi - slid)):
        called = [Signal(f"{name} friction{sign}", "N s", "friction impulse") for name in names]
        rows.add("friction", gap, row, called)
    slip = [Signal(f"{name} slip", "m", "way slid in a step") for name in names]
    rows.add("slip", bound - plus - minus, ca.SX(*J_t.shape), slip)
    return plus - minus


def _second_order_cone(rows: _Rows, names: tuple[str, ...], J_t: ca.SX, slid: ca.SX, bound: ca.SX,
                       cone: list[ca.SX]) -> ca.SX:  # fmt: skip
    """Add the eigenvalues ``f gamma ± beta`` of the cone; returns the impulse along the tangents.

    The lower one stands as the gap of the dual's, so that no equation but the pairs is needed.
    """
    upper, dual = cone
    edge = [Signal(f"{name} cone", "N s", "friction impulse above its least") for name in names]
    rows.add("friction", dual + 2 * slid, J_t, edge)
    slip = [Signal(f"{name} slip", "m", "twice the way slid back") for name in names]
    rows.add("slip", 2 * bound - upper, ca.SX(*J_t.shape), slip)
    return upper - bound
