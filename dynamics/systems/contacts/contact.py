"""Contacts between shapes, and the pairs and cones that they become."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import casadi as ca

from dynamics.systems.contacts.shapes import Pose, Shape
from dynamics.systems.pairs import Kind
from dynamics.systems.parameters import Signal


@dataclass(frozen=True, eq=False)
class Contact:
    """How a shape on a body with pose ``a`` is near a shape on a body with pose ``b``.

    ``phi`` signed distance [m], negative in penetration; ``normal`` (2, 1) unit vector out of B
    towards A; ``point`` (2, 1) [m] the point of A nearest to B. The nearest point of B is
    ``point - phi normal``.
    """

    a: Pose
    b: Pose
    phi: ca.SX
    normal: ca.SX
    point: ca.SX

    @classmethod
    def between(cls, one: Shape, a: Pose, other: Shape, b: Pose) -> Contact:
        """Contact of two convex shapes whose distance is that of a corner of either core.

        Right as long as the cores are apart or one holds a corner of the other, which is all that
        two cores can do but cross like swords. Where neither turns against the other this is the
        distance from a fixed convex set, once differentiable outside. Where they turn it is not,
        as soon as a side lies on another: there every corner is a contact of its own, see
        :func:`~dynamics.systems.contacts.polygon.vertex_pairs`.

        Raises ``ValueError`` for two half-planes.
        """
        near = [] if len(other.corners) == 1 < len(one.corners) else _corners(one, a, other, b)
        if len(one.corners) != 1:
            near += [
                (phi, -normal, point - phi * normal)
                for phi, normal, point in _corners(other, b, one, a)
            ]
        if not near:
            raise ValueError("two half-planes have no contact; one of the shapes must be bounded")
        phi, normal, point = near[0]
        for candidate in near[1:]:
            nearer = candidate[0] < phi
            normal, point = (
                ca.if_else(nearer, new, old)
                for new, old in zip(candidate[1:], (normal, point), strict=True)
            )
            phi = ca.fmin(phi, candidate[0])
        return cls(a, b, phi, normal, point)

    @property
    def tangent(self) -> ca.SX:
        """Unit vector along the surface of B (2, 1), forward on a floor: ``(n_z, -n_x)``."""
        return ca.vertcat(self.normal[1], -self.normal[0])

    def jacobians(self, q: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Rows ``J_n`` and ``J_t``, each (1, nq), of the relative velocity at the contact.

        ``J_n dq/dt`` and ``J_t dq/dt`` are normal and tangential part of the velocity of A's
        material point less that of B's [m/s], both taken at ``point``: a force and its reaction
        then act along one line. ``J_n`` is the gradient of ``phi``. q must be symbols.
        """
        slip = _point_jacobian(self.a, self.point, q) - _point_jacobian(self.b, self.point, q)
        # A floor's normal has a zero in it, which would else leave columns of explicit zeros.
        return ca.sparsify(self.normal.T @ slip), ca.sparsify(self.tangent.T @ slip)


def _corners(one: Shape, a: Pose, other: Shape, b: Pose) -> list[tuple[ca.SX, ca.SX, ca.SX]]:
    """Gap, normal out of the other shape and nearest point of every rounded corner of one."""
    found = []
    for corner in one.corners:
        centre = a.place(corner)
        distance, normal = other.beside(centre, b)
        found.append((distance - one.radius, normal, centre - one.radius * normal))
    return found


def _point_jacobian(body: Pose, point: ca.SX, q: ca.SX) -> ca.SX:
    arm = point - body.position
    swing = ca.vertcat(arm[1], -arm[0])
    return ca.jacobian(body.position, q) + swing @ ca.jacobian(body.angle, q)


class Row(NamedTuple):
    """Pairs of one kind, one for each contact: their gaps, and the directions of their impulses.

    ``gap`` (n, 1), ``direction`` (n, nq), and n ``signals``.
    """

    kind: Kind
    gap: ca.SX
    direction: ca.SX
    signals: list[Signal]


@dataclass(frozen=True, eq=False)
class Rubbing:
    """nc contacts that rub: ``gap`` (nc, 1) [m], rows ``J_n`` and ``J_t`` (nc, nq) along normal and
    tangent, Coulomb's ``friction`` f (nc, 1), and ``slid`` (nc, 1) [m] the way slid in a step.

    ``lam`` are the impulses along the first row's directions and those of the form's own rows.
    """

    contacts: tuple[Signal, ...]
    gap: ca.SX
    J_n: ca.SX
    J_t: ca.SX
    friction: ca.SX
    slid: ca.SX
    lam: list[ca.SX]

    @property
    def rubs(self) -> ca.SX:
        """One, or zero where there is no friction, now or as long as a parameter is zero.

        Without friction the cone has no inside for the path to run in: there the pairs are those of
        a contact with the coefficient 1 which does not slide, and they do not push.
        """
        return ca.if_else(self.friction == 0, 0, 1)

    @property
    def bound(self) -> ca.SX:
        """Largest impulse along the tangent, f gamma (nc, 1) [N s]."""
        return ca.if_else(self.friction == 0, 1, self.friction) * self.lam[0]

    def named(self, what: str, unit: str, description: str) -> list[Signal]:
        """``<contact><what>`` for every contact."""
        return [Signal(f"{c.name}{what}", unit, description) for c in self.contacts]


class ConeForm(NamedTuple):
    """A form of the cone: how many rows it adds to the normal one, and all of them.

    ``pairs`` returns the rows, the normal one first, and the impulses along normal and tangent.
    """

    more: int
    pairs: Callable[[Rubbing], tuple[list[Row], ca.SX, ca.SX]]


def _edge_pairs(at: Rubbing) -> tuple[list[Row], ca.SX, ca.SX]:
    """``lam± ⟂ gap ± f slid``, with the impulse ``sum (J_n ± f J_t)' lam±``.

    At the price that a sliding contact opens at the rate ``f |J_t v|`` (Anitescu, doi
    10.1007/s10107-005-0590-7).
    """
    plus, minus = at.lam
    J_t, slid = ca.diag(at.friction) @ at.J_t, at.friction * at.slid
    rows = []
    for sign, turned, way in (("+", J_t, slid), ("-", -J_t, -slid)):
        named = [Signal(f"{c.name}{sign}", c.unit, c.description) for c in at.contacts]
        rows.append(Row("normal", at.gap + way, at.J_n + turned, named))
    return rows, plus + minus, at.friction * (plus - minus)


EDGES = ConeForm(1, _edge_pairs)


def _linearised_pairs(at: Rubbing) -> tuple[list[Row], ca.SX, ca.SX]:
    """``gamma ⟂ gap``, ``beta± ⟂ psi ± slid`` and ``psi ⟂ f gamma - beta+ - beta-``."""
    gamma, plus, minus, psi = at.lam
    J_t, slid = ca.diag(at.rubs) @ at.J_t, at.rubs * at.slid
    still = ca.SX(*J_t.shape)
    rows = [
        Row("normal", at.gap, at.J_n, list(at.contacts)),
        Row("friction", psi + slid, J_t, at.named(" friction+", "N s", "friction impulse")),
        Row("friction", psi - slid, -J_t, at.named(" friction-", "N s", "friction impulse")),
        Row("slip", at.bound - plus - minus, still, at.named(" slip", "m", "way slid in a step")),
    ]
    return rows, gamma, at.rubs * (plus - minus)


LINEARISED = ConeForm(3, _linearised_pairs)


def _second_order_pairs(at: Rubbing) -> tuple[list[Row], ca.SX, ca.SX]:
    """``gamma ⟂ gap``, ``upper ⟂ dual + 2 slid`` and ``dual ⟂ 2 f gamma - upper``.

    The lower eigenvalue stands as the gap of the dual's, so that no equation but the pairs is
    needed.
    """
    gamma, upper, dual = at.lam
    J_t, slid = ca.diag(at.rubs) @ at.J_t, at.rubs * at.slid
    still = ca.SX(*J_t.shape)
    above = at.named(" cone", "N s", "friction impulse above its least")
    back = at.named(" slip", "m", "twice the way slid back")
    rows = [
        Row("normal", at.gap, at.J_n - ca.diag(at.friction) @ at.J_t, list(at.contacts)),
        Row("friction", dual + 2 * slid, J_t, above),
        Row("slip", 2 * at.bound - upper, still, back),
    ]
    return rows, gamma, at.rubs * (upper - at.bound)


SECOND_ORDER = ConeForm(2, _second_order_pairs)
