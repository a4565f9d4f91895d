"""Friction between a body and the table that it lies on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import casadi as ca

from dynamics.systems.contact_rows import ContactRows
from dynamics.systems.pairs import Pair
from dynamics.systems.parameters import Signal


@dataclass(frozen=True, eq=False)
class LimitSurface:
    """Friction of the body ``name`` on a table; its coordinates x, y (and angle) start at the index ``first``.

    The friction wrench w = (f_x, f_y, m) stays within the ellipsoid ``|g| <= 1``, ``g = (f_x, f_y, m / reach) /
    force`` (Goyal, Ruina and Papadopoulos, doi 10.1016/0043-1648(91)90104-3; Lynch, doi 10.1109/70.508439), and where
    w lies on the surface of the ellipsoid, the body slides along its normal at w::

        (dx, dy, reach dangle) = s g,   0 <= s ⟂ h force (1 - |g|²) / 2 >= 0

    with s [m] the distance slid in a step. To keep the step affine in its multipliers, ``s g`` is
    written ``p - n``, with ``0 <= p ⟂ m/h (p - s g) >= 0`` and ``0 <= n ⟂ m/h (n + s g) >= 0``.

    ``force`` [N] is Coulomb's coefficient times the weight, ``reach`` [m] the mean distance of the
    pressure from the centre of mass, None for a body that never rotates. w is the applied wrench, minus ``M dq / h²``
    if the body is ``inertial``; otherwise the body is quasi-static.
    """

    name: str
    first: int
    force: ca.SX | float
    reach: ca.SX | float | None = None
    inertial: bool = True

    @property
    def lengths(self) -> ca.SX:
        """Factors from changes of coordinates to distances [m]: 1, 1 and ``reach``."""
        angle_length = ca.SX(0, 1) if self.reach is None else ca.SX(self.reach)
        return ca.vertcat(ca.SX.ones(2), angle_length)


def add_table_friction(
    rows: ContactRows,
    residual: ca.SX,
    dq: ca.SX,
    pushed: ca.SX,
    mass: ca.SX,
    surfaces: Sequence[LimitSurface],
    h: ca.SX | float,
) -> tuple[ContactRows, ca.SX]:
    """Return ``rows`` with the pairs of bodies on a table added, and ``residual`` with their sliding motion added.

    ``pushed`` are the impulses of contacts and load (nq, 1) [N s], ``mass`` is M (nq, nq).
    """
    residual, contacts = ca.SX(residual), 1 + max((p.contact for p in rows.pairs), default=-1)
    for number, surface in enumerate(surfaces):
        lengths = surface.lengths
        n_axes = lengths.numel()
        entries = slice(surface.first, surface.first + n_axes)
        p, n, s = (
            ca.SX.sym(f"{surface.name}_{direction}", size)
            for direction, size in (("forward", n_axes), ("backward", n_axes), ("slid", 1))
        )
        impulse = pushed[entries] - (mass @ dq / h)[entries] if surface.inertial else pushed[entries]
        bound = h * surface.force
        g, unit = impulse / lengths / bound, mass[surface.first, surface.first] / h
        residual[entries] = dq[entries] - (p - n) / lengths
        gaps = unit * (p - s * g), unit * (n + s * g), bound * (1 - ca.sumsqr(g)) / 2
        directions = [
            f"{direction} {axis}" for direction in ("forward", "backward") for axis in ["x", "y", "angle"][:n_axes]
        ]
        rows = replace(
            rows,
            lam=ca.vertcat(rows.lam, p, n, s),
            gap=ca.vertcat(rows.gap, *gaps),
            signals=(
                *rows.signals,
                *(
                    Signal(f"{surface.name} on table {direction}", "m", "distance slid in a step")
                    for direction in [*directions, "slid"]
                ),
            ),
            pairs=(*rows.pairs, *[Pair("table", contacts + number)] * (2 * n_axes + 1)),
        )
    return rows, residual
