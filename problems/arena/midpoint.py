"""Variational midpoint steps, whose momentum balance is implicit in the next velocity."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca


@dataclass(frozen=True)
class Midpoint:
    """Steps of size h [s] of a machine with mass matrix ``mass(q)`` and ``bias(q, v)`` (velocity terms, gravity).

    With v+ = (q+ - q)/h and the midpoints m- = q - h v/2, m+ = q + h v+/2 the balance of momentum is
    ``M(m+) v+ - M(m-) v + h/2 (bias(m+, v+) + bias(m-, v)) = impulse``.
    """

    mass: Callable[[ca.SX], ca.SX]
    bias: Callable[[ca.SX, ca.SX], ca.SX]
    h: ca.SX

    def momentum_change(self, q: ca.SX, v: ca.SX, v_next: ca.SX) -> ca.SX:
        """Return the left side of the balance (nq, 1) [N s or N m s]."""
        before, after = q - self.h * v / 2, q + self.h * v_next / 2
        momentum = self.mass(after) @ v_next - self.mass(before) @ v
        return momentum + self.h / 2 * (self.bias(after, v_next) + self.bias(before, v))
