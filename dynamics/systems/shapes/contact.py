"""Contacts between plane shapes, and formulations of the friction cone as complementarity pairs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import casadi as ca

from dynamics.systems.pairs import Kind
from dynamics.systems.parameters import Signal
from dynamics.systems.shapes.planar import Pose, Shape


@dataclass(frozen=True, eq=False)
class Contact:
    """Contact of a shape A on a body with pose ``a`` and a shape B on a body with pose ``b``.

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
    def between(cls, shape_a: Shape, pose_a: Pose, shape_b: Shape, pose_b: Pose) -> Contact:
        """Return the contact of two convex shapes, at the corner of either core that is nearest to the other shape.

        The distance is exact if the cores are disjoint or one contains a corner of the other, but not if they
        cross and neither contains a corner of the other. For shapes that do not rotate relative to each
        other it is the distance from a fixed convex set, once differentiable outside that set. For shapes that
        rotate, the distance has kinks at poses where two sides coincide; make each corner a separate contact in this
        case, see :func:`~dynamics.systems.shapes.polygon.vertex_pairs`.

        Raises ``ValueError`` for two half-planes.
        """
        candidates = (
            [] if len(shape_b.corners) == 1 < len(shape_a.corners) else _corners(shape_a, pose_a, shape_b, pose_b)
        )
        if len(shape_a.corners) != 1:
            candidates += [
                (phi, -normal, point - phi * normal)
                for phi, normal, point in _corners(shape_b, pose_b, shape_a, pose_a)
            ]
        if not candidates:
            raise ValueError("two half-planes have no contact; one of the shapes must be bounded")
        phi, normal, point = candidates[0]
        for candidate in candidates[1:]:
            nearer = candidate[0] < phi
            normal, point = (
                ca.if_else(nearer, new, old) for new, old in zip(candidate[1:], (normal, point), strict=True)
            )
            phi = ca.fmin(phi, candidate[0])
        return cls(pose_a, pose_b, phi, normal, point)

    @property
    def tangent(self) -> ca.SX:
        """Unit vector along the surface of B (2, 1), forward on a floor: ``(n_z, -n_x)``."""
        return ca.vertcat(self.normal[1], -self.normal[0])

    def jacobians(self, q: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return the rows ``J_n`` and ``J_t``, each (1, nq), of the relative velocity at the contact.

        ``J_n dq/dt`` and ``J_t dq/dt`` are the normal and the tangential component of A's velocity relative to B's
        [m/s], both at ``point``, so that a force and its reaction act along one line. ``J_n`` is the gradient of
        ``phi``. q must be symbols.
        """
        slip = _point_jacobian(self.a, self.point, q) - _point_jacobian(self.b, self.point, q)
        # A floor's normal has a zero entry, which would otherwise leave columns of explicit zeros.
        return ca.sparsify(self.normal.T @ slip), ca.sparsify(self.tangent.T @ slip)


def _corners(shape: Shape, pose: Pose, other_shape: Shape, other_pose: Pose) -> list[tuple[ca.SX, ca.SX, ca.SX]]:
    """Return, for each rounded corner of ``shape``, gap, normal out of the other shape, and nearest point."""
    corner_contacts = []
    for corner in shape.corners:
        centre = pose.to_world(corner)
        distance, normal = other_shape.signed_distance(centre, other_pose)
        corner_contacts.append((distance - shape.radius, normal, centre - shape.radius * normal))
    return corner_contacts


def _point_jacobian(body: Pose, point: ca.SX, q: ca.SX) -> ca.SX:
    arm = point - body.position
    swing = ca.vertcat(arm[1], -arm[0])
    return ca.jacobian(body.position, q) + swing @ ca.jacobian(body.angle, q)


class Row(NamedTuple):
    """Complementarity pairs of one kind, one per contact: their gaps, and the directions of their impulses.

    ``gap`` (n, 1), ``direction`` (n, nq), and n ``signals``.
    """

    kind: Kind
    gap: ca.SX
    direction: ca.SX
    signals: list[Signal]


@dataclass(frozen=True, eq=False)
class FrictionSpec:
    """The nc contacts with friction: ``gap`` (nc, 1) [m], and rows ``J_n`` (nc, nq) along the normals.

    ``J_t`` are rows (nc, nq) along each direction of the friction cone (one direction in the plane), and ``slip``
    (nc, 1) [m] the distances slid along them in a step; ``friction`` is Coulomb's f (nc, 1). ``lam``
    are the multipliers (nc, 1) of the normal row, then those of the cone formulation's other rows.
    """

    contacts: tuple[Signal, ...]
    gap: ca.SX
    J_n: ca.SX
    J_t: list[ca.SX]
    friction: ca.SX
    slip: list[ca.SX]
    lam: list[ca.SX]

    @property
    def has_friction(self) -> ca.SX:
        """Indicator (nc, 1): 1, or 0 if the friction coefficient is zero.

        A central path needs a friction cone with an interior. Without friction the cone has no interior; the pairs are
        then those of a contact with coefficient 1 that does not slide, and they exert no impulse.
        """
        return ca.if_else(self.friction == 0, 0, 1)

    @property
    def bound(self) -> ca.SX:
        """Maximum tangential impulse f gamma (nc, 1) [N s], with f = 1 if the friction is zero."""
        return ca.if_else(self.friction == 0, 1, self.friction) * self.lam[0]

    @property
    def directions(self) -> list[tuple[str, ca.SX, ca.SX]]:
        """Tangential directions, each with its number as text (empty in the plane), rows, and distance slid."""
        numbers = [""] if len(self.J_t) == 1 else [str(k) for k in range(1, len(self.J_t) + 1)]
        return list(zip(numbers, self.J_t, self.slip, strict=True))

    def suffixed_signals(self, suffix: str, unit: str, description: str) -> list[Signal]:
        """Return a signal called ``<contact><suffix>`` for each contact."""
        return [Signal(f"{c.name}{suffix}", unit, description) for c in self.contacts]


class ConeForm(NamedTuple):
    """A formulation of the friction cone as complementarity pairs: the number of pairs, and their rows.

    ``n_further`` maps the number of tangential directions to the number of rows besides the normal row. ``pairs``
    returns all rows, the normal row first, and the impulses along the normal and along every direction.
    """

    n_further: Callable[[int], int]
    pairs: Callable[[FrictionSpec], tuple[list[Row], ca.SX, list[ca.SX]]]


def _edge_pairs(at: FrictionSpec) -> tuple[list[Row], ca.SX, list[ca.SX]]:
    """Return the pairs ``lam± ⟂ gap ± f slip``, with the impulse ``sum (J_n ± f J_t)' lam±``.

    A sliding contact opens at the rate ``f |J_t v|`` (Anitescu, doi 10.1007/s10107-005-0590-7).
    """
    rows, tangential, total, lam = [], [], ca.SX(at.gap.numel(), 1), iter(at.lam)
    for number, J_t, slip in at.directions:
        J_t, scaled_slip = ca.diag(at.friction) @ J_t, at.friction * slip
        plus, minus = next(lam), next(lam)
        for sign, rows_J, signed_slip in (("+", J_t, scaled_slip), ("-", -J_t, -scaled_slip)):
            named = [Signal(f"{c.name}{sign}{number}", c.unit, c.description) for c in at.contacts]
            rows.append(Row("normal", at.gap + signed_slip, at.J_n + rows_J, named))
        total += plus + minus
        tangential.append(at.friction * (plus - minus))
    return rows, total, tangential


# Friction cone written by its edges, which is convex, but opens a sliding contact.
EDGES = ConeForm(lambda directions: 2 * directions - 1, _edge_pairs)


def _linearised_pairs(at: FrictionSpec) -> tuple[list[Row], ca.SX, list[ca.SX]]:
    """Return the pairs ``gamma ⟂ gap``, ``beta± ⟂ psi ± slip`` and ``psi ⟂ f gamma - sum of all beta``."""
    gamma, *betas, psi = at.lam
    rows, tangential = [Row("normal", at.gap, at.J_n, list(at.contacts))], []
    for k, (number, J_t, slip) in enumerate(at.directions):
        J_t, scaled_slip = ca.diag(at.has_friction) @ J_t, at.has_friction * slip
        for sign, rows_J, signed_slip in (("+", J_t, scaled_slip), ("-", -J_t, -scaled_slip)):
            named = at.suffixed_signals(f" friction{number}{sign}", "N s", "friction impulse")
            rows.append(Row("friction", psi + signed_slip, rows_J, named))
        tangential.append(at.has_friction * (betas[2 * k] - betas[2 * k + 1]))
    cone_margin = at.bound
    for beta in betas:
        cone_margin = cone_margin - beta
    no_impulse, named = ca.SX(*at.J_n.shape), at.suffixed_signals(" slip", "m", "distance slid in a step")
    rows.append(Row("slip", cone_margin, no_impulse, named))
    return rows, gamma, tangential


# Linearised friction cone with maximum dissipation.
LINEARISED = ConeForm(lambda directions: 2 * directions + 1, _linearised_pairs)


def _second_order_pairs(at: FrictionSpec) -> tuple[list[Row], ca.SX, list[ca.SX]]:
    """Return the pairs ``gamma ⟂ gap``, ``upper ⟂ dual + 2 slip`` and ``dual ⟂ 2 f gamma - upper``.

    The cone's lower eigenvalue is the gap of ``dual``, so that no further equation is needed.
    """
    if len(at.J_t) > 1:
        raise ValueError("the second-order cone is written for one tangent; take cone='linearised'")
    gamma, upper, dual = at.lam
    J_t, slip = ca.diag(at.has_friction) @ at.J_t[0], at.has_friction * at.slip[0]
    no_impulse = ca.SX(*J_t.shape)
    upper_signals = at.suffixed_signals(" cone", "N s", "friction impulse above its minimum")
    slip_signals = at.suffixed_signals(" slip", "m", "twice the distance slid backwards")
    rows = [
        Row("normal", at.gap, at.J_n - ca.diag(at.friction) @ at.J_t[0], list(at.contacts)),
        Row("friction", dual + 2 * slip, J_t, upper_signals),
        Row("slip", 2 * at.bound - upper, no_impulse, slip_signals),
    ]
    return rows, gamma, [at.has_friction * (upper - at.bound)]


# Second-order friction cone, for one tangent.
SECOND_ORDER = ConeForm(lambda directions: 2, _second_order_pairs)
