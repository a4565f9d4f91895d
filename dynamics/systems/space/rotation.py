"""Unit quaternions (w, x, y, z) as SX: products, rotations, and turning by a rotation vector."""

from __future__ import annotations

import casadi as ca

_SERIES_LIMIT = 1e-3
"""Squares of half angles [rad²] below which sine and cosine are their series."""


def product(a: ca.SX, b: ca.SX) -> ca.SX:
    """Hamilton's product of two quaternions (4, 1): turn by b, then by a."""
    return ca.vertcat(
        a[0] * b[0] - ca.dot(a[1:], b[1:]),
        a[0] * b[1:] + b[0] * a[1:] + ca.cross(a[1:], b[1:]),
    )


def matrix(q: ca.SX) -> ca.SX:
    """Rotation matrix (3, 3) of a unit quaternion, ``R(q) v = q v q*``."""
    w, x, y, z = ca.vertsplit(q)
    return ca.vertcat(
        ca.horzcat(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        ca.horzcat(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        ca.horzcat(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


def from_axis_angle(axis: ca.SX, angle: ca.SX) -> ca.SX:
    """Rotation matrix (3, 3) about a unit ``axis`` (3, 1) by ``angle`` [rad], Rodrigues' formula.

    Along an axis of coordinates the entries that are zero or one are so structurally.
    """
    c, s = ca.cos(angle), ca.sin(angle)
    for k in range(3):
        if (axis[k] ** 2 - 1).is_zero():
            i, j = (k + 1) % 3, (k + 2) % 3
            R = ca.SX.eye(3)
            R[i, i] = R[j, j] = c
            R[i, j], R[j, i] = -axis[k] * s, axis[k] * s
            return R
    return c * ca.SX.eye(3) + s * ca.skew(axis) + (1 - c) * (axis @ axis.T)


def integrate(q: ca.SX, rotation_vector: ca.SX) -> ca.SX:
    """``q (+) way``: q turned about ``rotation_vector`` (3, 1) in its own axes by its length [rad], exactly.

    ``q exp(way / 2)``, drawn back to the unit sphere by one step of Newton's method, so that
    rounding does not add up over steps.
    """
    half_angle_squared = ca.sumsqr(rotation_vector) / 4
    is_small = half_angle_squared < _SERIES_LIMIT
    # Away from zero the series' branch is not used; at zero the root's slope would be infinite.
    half_angle = ca.sqrt(ca.if_else(is_small, 1, half_angle_squared))
    w = ca.if_else(
        is_small,
        1 - half_angle_squared * (1 / 2 - half_angle_squared * (1 / 24 - half_angle_squared / 720)),
        ca.cos(half_angle),
    )
    sinc_series = 1 - half_angle_squared * (1 / 6 - half_angle_squared * (1 / 120 - half_angle_squared / 5040))
    sinc = ca.if_else(is_small, sinc_series, ca.sin(half_angle) / half_angle)
    return product(q, ca.vertcat(w, sinc * rotation_vector / 2)) * ((3 - ca.sumsqr(q)) / 2)


def rate_matrix(q: ca.SX) -> ca.SX:
    """Derivative (4, 3) of ``q (+) way`` by way at zero, for unit q: ``dq/dt = slope(q) omega``."""
    w, v = q[0], q[1:]
    return ca.vertcat(-v.T, w * ca.SX.eye(3) + ca.skew(v)) / 2
