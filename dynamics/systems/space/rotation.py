"""Unit quaternions (w, x, y, z) as SX: products, rotation matrices, and integration of rotation vectors."""

from __future__ import annotations

import casadi as ca

_SERIES_LIMIT = 1e-3
"""Square of the half angle [rad²] below which sine and cosine are computed by their series."""


def product(a: ca.SX, b: ca.SX) -> ca.SX:
    """Return the Hamilton product of two quaternions (4, 1): rotation by b, then by a."""
    return ca.vertcat(
        a[0] * b[0] - ca.dot(a[1:], b[1:]),
        a[0] * b[1:] + b[0] * a[1:] + ca.cross(a[1:], b[1:]),
    )


def matrix(q: ca.SX) -> ca.SX:
    """Return the rotation matrix (3, 3) of a unit quaternion, ``R(q) v = q v q*``."""
    w, x, y, z = ca.vertsplit(q)
    return ca.vertcat(
        ca.horzcat(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        ca.horzcat(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        ca.horzcat(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


def from_axis_angle(axis: ca.SX, angle: ca.SX) -> ca.SX:
    """Return the rotation matrix (3, 3) about a unit ``axis`` (3, 1) by ``angle`` [rad], Rodrigues' formula.

    About a coordinate axis the entries 0 and 1 are constants of the graph.
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
    """Return ``q (+) w``: q rotated by ``rotation_vector`` w (3, 1) [rad], given in the rotated frame's axes.

    The result is ``q exp(w / 2)``, exact and normalised by one step of Newton's method, so that rounding errors
    do not add up over steps.
    """
    half_angle_squared = ca.sumsqr(rotation_vector) / 4
    is_small = half_angle_squared < _SERIES_LIMIT
    # Where the series is used the root's argument is 1, as its slope at 0 would be infinite.
    half_angle = ca.sqrt(ca.if_else(is_small, 1, half_angle_squared))
    w = ca.if_else(
        is_small,
        1 - half_angle_squared * (1 / 2 - half_angle_squared * (1 / 24 - half_angle_squared / 720)),
        ca.cos(half_angle),
    )
    sinc_series = 1 - half_angle_squared * (1 / 6 - half_angle_squared * (1 / 120 - half_angle_squared / 5040))
    sinc = ca.if_else(is_small, sinc_series, ca.sin(half_angle) / half_angle)
    return product(q, ca.vertcat(w, sinc * rotation_vector / 2)) * ((3 - ca.sumsqr(q)) / 2)
