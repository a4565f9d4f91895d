"""The box of figure A6, softened, in closed form."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.stats import norm


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


def smoothed_box(
    u: np.ndarray, sigma: float, m: float, g: float, friction: float, h: float
) -> tuple[np.ndarray, np.ndarray]:
    """Mean and variance, (n,) each, of the exact dv+/du [m/(N s)] at pushes N(u, sigma²).

    The exact one is h/m where |u| > friction m g, else 0, so p = P(slip) decides both.
    """
    bound = friction * m * g
    p = norm.sf((bound - u) / sigma) + norm.sf((bound + u) / sigma)
    return h / m * p, (h / m) ** 2 * p * (1 - p)


@dataclass(frozen=True)
class Cost:
    """One solve of a softened box against exact ones averaged over noise of equal bias.

    ``bias`` [m/(N s)]: root mean square over the pushes of softened less exact slope; ``sigma``
    [N]: noise whose average has the same; ``single``: error of one exact solve over that bias;
    ``needed``: solves after which the error is within a tenth of it.
    """

    bias: float
    sigma: float
    single: float
    needed: float


def cost_of_averaging(u: np.ndarray, mu: float, **box: float) -> Cost:
    """Compare both smoothings of the slope over pushes ``u``, a fine grid past both steps."""
    exact = np.where(np.abs(u) > box["friction"] * box["m"] * box["g"], box["h"] / box["m"], 0.0)

    def size(values: np.ndarray) -> float:
        return float(np.sqrt(np.mean(values**2)))

    bias = size(softened_box(u, mu, **box)[1] - exact)

    def excess(sigma: float) -> float:
        return size(smoothed_box(u, sigma, **box)[0] - exact) - bias

    # Far below the grid's spacing RS is exact on it; far above its reach it slips everywhere.
    least, most = 1e-2 * float(u[1] - u[0]), 1e6 * float(np.ptp(u))
    sigma = float(brentq(excess, least, most))  # pyright: ignore[reportArgumentType]
    variance = float(np.mean(smoothed_box(u, sigma, **box)[1]))
    return Cost(bias, sigma, np.sqrt(1 + variance / bias**2), variance / (0.21 * bias**2))
