"""A contact of two shapes of the plane: gap, normal, tangent, point, and the motion along them."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from dynamics.systems.contacts.shapes import Pose, Shape


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
        two cores can do but cross like swords. Not differentiable where two corners are equally
        near, as where a side lies on another: there take the corners as discs of their own.

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
