"""The softened ball in continuous time: ``y'' = mu/y - g``, integrated in ln y."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.special import lambertw


def in_log_height(
    mu: float, q0: float, g: float, times: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Height and vertical velocity at ``times`` [s], (n,), of a ball thrown level from q0 [m].

    ``s = ln y``: ``s' = v exp(-s)``, ``v' = mu exp(-s) - g`` per unit mass, mu in J/kg; in y
    itself the least height, about ``q0 exp(-g q0/mu)``, is lost (abs, C.1 in other variables).
    """
    found = _integrate(mu, q0, g, times[-1], times)
    return np.exp(found.y[0]), found.y[1]


def turning_points(mu: float, q0: float, g: float) -> tuple[float, float, float]:
    """Least height [m], the height regained [m] and when [s], for mu < g q0."""

    def velocity(_: float, state: np.ndarray) -> float:
        return state[1]

    longest = 20 * float(np.sqrt(q0 / g))
    found = _integrate(mu, q0, g, longest, None, velocity)
    heights = np.exp(found.y_events[0][:, 0])
    # The throw itself is level: its own event, where there is one, is at time 0.
    moving = found.t_events[0] > 0
    times, heights = found.t_events[0][moving], heights[moving]
    return float(heights[0]), float(heights[1]), float(times[1])


def _integrate(mu: float, q0: float, g: float, end: float, times: Any, events: Any = None) -> Any:
    def slope(_: float, state: np.ndarray) -> list[float]:
        inverse = np.exp(-state[0])
        return [state[1] * inverse, mu * inverse - g]

    found = solve_ivp(slope, (0.0, end), [np.log(q0), 0.0], "DOP853", times, events=events,
                      rtol=1e-11, atol=1e-12)  # fmt: skip
    if not found.success:
        raise ValueError(f"the ball's equation could not be integrated at mu = {mu}")
    return found


def as_printed(mu: float, q0: float, g: float, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Contact force and vertical velocity at ``times`` by the pair (gamma, e) of abs, C.1."""

    def slope(_: float, state: np.ndarray) -> list[float]:
        gamma, e, _ = state
        return [e, (gamma**4 - gamma**3 * g - 2 * mu * e**2) / (-mu * gamma), gamma - g]

    found = solve_ivp(slope, (times[0], times[-1]), [mu / q0, 0.0, 0.0], "DOP853", times,
                      rtol=1e-11, atol=1e-12)  # fmt: skip
    return found.y[0], found.y[2]


def least_height(mu: float, q0: float, g: float) -> float:
    """Where all energy is potential on the way down: ``-(mu/g) W0(-(g/mu) exp(-E/mu))``.

    ``E = g q0 - mu ln q0``; W0 is Lambert's function.
    """
    energy = g * q0 - mu * np.log(q0)
    return float(-(mu / g) * lambertw(-(g / mu) * np.exp(-energy / mu)).real)
