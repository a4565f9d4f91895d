"""The box of figure A6, softened, in closed form."""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq


def softened_box(
    u: np.ndarray, mu: float, m: float, g: float, friction: float, h: float
) -> tuple[np.ndarray, np.ndarray]:
    """Next velocity [m/s] from rest and its derivative by the push u [m/(N s)], both (n,).

    A barrier on both faces of |f| <= b = friction h m g, f an impulse, gives
    ``v+ = r(f) = -(2 mu/h) f/(b² - f²)`` with ``m v+ = h u + f``, one root f; mu in N s m. Its
    derivative is ``(h/m) c/(1 + c)``, ``c = -m r'(f) = (2 m mu/h) (b² + f²)/(b² - f²)²``, which
    tends to 0 in stick and to h/m in slip.
    """
    b = friction * h * m * g

    def root(push: float) -> float:
        def relation(f: float) -> float:
            return (h * push + f) * (b**2 - f**2) / m + 2 * mu / h * f

        return float(brentq(relation, -b, b, xtol=1e-15))  # pyright: ignore[reportArgumentType]

    f = np.array([root(push) for push in u])
    c = 2 * m * mu / h * (b**2 + f**2) / (b**2 - f**2) ** 2
    return (h * u + f) / m, h / m * c / (1 + c)
