"""Dry friction with a given schedule of modes as a convex QP, independent of the workbench."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from tests.golden.convex import convex


@dataclass(frozen=True)
class Slide:
    """Problem ``M (v+ - v) = h B u + J' f``, |f| <= bound, from (q, v), with one step for each mode.

    The cost is ``sum w_u h u² + w_end |q_N - goal|² + w_v |v_N|²``, with |u| <= u_max, |q| <= reach.
    """

    M: np.ndarray
    B: np.ndarray
    J: np.ndarray
    h: float
    bound: float
    q: np.ndarray
    v: np.ndarray
    goal: np.ndarray
    reach: np.ndarray
    w_u: float
    w_end: float
    w_v: float
    u_max: float

    def best(self, modes: np.ndarray) -> float:
        """Return the minimum cost under a schedule (1 slides forward, -1 backward, 0 sticks); inf if infeasible."""
        u = ca.SX.sym("u", len(modes))
        q, v = ca.SX(self.q), ca.SX(self.v)
        inverse = np.linalg.inv(self.M)
        compliance = float(self.J @ inverse @ self.J)
        rows, low, high = [], [], []
        for k, mode in enumerate(modes):
            free = v + inverse @ (self.h * self.B * u[k])
            f = -mode * self.bound if mode else -ca.dot(self.J, free) / compliance
            v = free + inverse @ self.J * f
            q = q + self.h * v
            rows += [mode * ca.dot(self.J, v) if mode else f, q]
            low += [0 if mode else -self.bound, *-self.reach]
            high += [np.inf if mode else self.bound, *self.reach]
        cost = self.w_u * self.h * ca.sumsqr(u) + self.w_end * ca.sumsqr(q - self.goal)
        least = convex(u, cost + self.w_v * ca.sumsqr(v), ca.vertcat(*rows))
        return least(-self.u_max, self.u_max, np.array(low), np.array(high))


def box(m=1.0, g=9.81, friction=0.5, h=0.05, goal=1.0) -> Slide:
    """Return ``box-slide``, by default at its default parameters."""
    one, rest = np.ones(1), np.zeros(1)
    return Slide(
        m * np.eye(1), one, one, h, friction * h * m * g, rest, rest, goal * one, 1e3 * one, 0.01, 100.0, 10.0, 15.0
    )


def cart(mc=2.0, mb=1.0, g=9.81, friction=0.2, h=0.05) -> Slide:
    """Return ``cart-transport``, by default at its default parameters; q is the cart and the box's offset."""
    M = np.array([[mc + mb, mb], [mb, mb]])
    return Slide(
        M,
        np.array([1.0, 0.0]),
        np.array([0.0, 1.0]),
        h,
        friction * h * mb * g,
        np.array([0.0, -0.2]),
        np.zeros(2),
        np.array([1.0, 0.2]),
        np.array([1e3, 0.5]),
        0.01,
        100.0,
        10.0,
        20.0,
    )


def window(start: int, end: int, steps: int = 40) -> np.ndarray:
    """Return a schedule that slides forward in the steps ``start`` to ``end - 1`` and sticks in the others."""
    modes = np.zeros(steps, dtype=int)
    modes[start:end] = 1
    return modes
