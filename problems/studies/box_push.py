"""A box on a rough floor as a linear complementarity system, and its softening in closed form."""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq

from dynamics.systems import ContactSystem, lcs, signals

REGULARISATION = 1e-4
"""Slack of the friction bound per backward velocity [N s/m]: makes F a P-matrix."""


def box_system(m: float, g: float, friction: float, h: float) -> ContactSystem:
    """Push a box of mass m [kg] along a floor; state (x, v), input a force u [N], step h [s].

    ``v+ = v + (h/m) (u + f)`` with the friction force of maximal dissipation, |f| <= bound =
    friction m g: ``0 <= bound + f ⟂ v+_forward >= 0``, ``0 <= v+_backward ⟂ bound - f >= 0``,
    v+ = forward - backward. The multipliers are (bound + f) [N] and the backward velocity [m/s].
    """
    bound, rate = friction * m * g, h / m
    return lcs(
        "box push",
        A=[[1, h], [0, 1]], B=[[h * rate], [rate]], C=[[h * rate, 0], [rate, 0]],
        c=[-h * rate * bound, -rate * bound],
        D=[[0, 1], [0, 0]], E=[[rate], [0]], F=[[rate, 1], [-1, REGULARISATION]],
        d=[-rate * bound, 2 * bound],
        states=signals("x [m]; v [m/s]"), inputs=signals("u [N]"),
        contacts=signals("f_plus_bound [N]; v_backward [m/s]"), h=h,
    )  # fmt: skip


def softened_velocity(
    u: np.ndarray, mu: float, m: float, g: float, friction: float, h: float
) -> np.ndarray:
    """v+ from rest with a barrier on both faces: ``v+ = -2 mu f/(bound² - f²)``, root in f."""
    bound, rate = friction * m * g, h / m

    def root(push: float) -> float:
        def relation(f: float) -> float:
            return rate * (push + f) * (bound**2 - f**2) + 2 * mu * f

        f = float(brentq(relation, -bound, bound, xtol=1e-14))  # pyright: ignore[reportArgumentType]
        return rate * (push + f)

    return np.array([root(push) for push in u])
