"""A2: a bouncing ball, simulated by the softened equation of motion and by time stepping."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from scipy.integrate import solve_ivp
from scipy.special import lambertw

from dynamics.contact import Barrier, Exact
from problems.registry import get
from problems.studies.shared.sampled_step import SampledStep
from problems.studies.study import PAPER, Claim, StudyParams, claim, dataset, format_values, largest_value, setting

NOTES = (
    "mu is that of the force, gamma y = mu; the impulse of one step has h mu. Its values are"
    " our choice, within what C.1 can be integrated at: least height is about exp(-g q0/mu).",
    "The equation conserves energy, so the softened ball bounces back to its height, whatever"
    " mu; the complementarity system of the paper is plastic. Neither is the other's limit:"
    " mu to 0 at fixed h rests on the floor, h to 0 at fixed mu bounces.",
)


def in_log_height(mu: float, q0: float, g: float, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return height [m] and vertical velocity [m/s] at ``times`` [s], (n,), of a ball thrown horizontally from q0 [m].

    The integration of Zhang et al. 2023, eq. C.1, is in ``s = ln y``: ``s' = v exp(-s)``, ``v' = mu exp(-s) - g``,
    with mu in J/kg; in y, rounding errors would exceed the minimum height, about ``q0 exp(-g q0/mu)``.
    """
    trajectory = _integrate(mu, q0, g, times[-1], times)
    return np.exp(trajectory.y[0]), trajectory.y[1]


def turning_points(mu: float, q0: float, g: float) -> tuple[float, float, float]:
    """Return the minimum height [m], and height [m] and time [s] of the rebound, for mu [J/kg] below g q0."""

    def velocity(_: float, state: np.ndarray) -> float:
        return state[1]

    longest = 20 * float(np.sqrt(q0 / g))
    trajectory = _integrate(mu, q0, g, longest, None, velocity)
    heights = np.exp(trajectory.y_events[0][:, 0])
    # The vertical velocity is zero at the start, which may count as an event at time 0.
    moving = trajectory.t_events[0] > 0
    times, heights = trajectory.t_events[0][moving], heights[moving]
    return float(heights[0]), float(heights[1]), float(times[1])


def _integrate(mu: float, q0: float, g: float, end: float, times: Any, events: Any = None) -> Any:
    def slope(_: float, state: np.ndarray) -> list[float]:
        inverse = np.exp(-state[0])
        return [state[1] * inverse, mu * inverse - g]

    trajectory = solve_ivp(slope, (0.0, end), [np.log(q0), 0.0], "DOP853", times, events=events, rtol=1e-11, atol=1e-12)
    if not trajectory.success:
        raise ValueError(f"the ball's equation could not be integrated at mu = {mu}")
    return trajectory


def as_printed(mu: float, q0: float, g: float, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return contact force per mass [m/s²] and vertical velocity at ``times`` by eq. C.1 of Zhang et al. 2023."""

    def slope(_: float, state: np.ndarray) -> list[float]:
        gamma, e, _ = state
        return [e, (gamma**4 - gamma**3 * g - 2 * mu * e**2) / (-mu * gamma), gamma - g]

    trajectory = solve_ivp(slope, (times[0], times[-1]), [mu / q0, 0.0, 0.0], "DOP853", times, rtol=1e-11, atol=1e-12)
    return trajectory.y[0], trajectory.y[2]


def least_height(mu: float, q0: float, g: float) -> float:
    """Return the minimum height [m], where all energy is potential: ``-(mu/g) W0(-(g/mu) exp(-E/mu))``.

    ``E = g q0 - mu ln q0``; W0 is the Lambert function.
    """
    energy = g * q0 - mu * np.log(q0)
    return float(-(mu / g) * lambertw(-(g / mu) * np.exp(-energy / mu)).real)


MUS = (1.0, 2.0, 3.0, 5.0)
"""Central-path parameters of the force [J/kg]."""
FINE = (1e-2, 3e-3, 1e-3, 3e-4, 1e-4)
"""Step sizes [s] at which the rebound is measured."""
REBOUND_MU = 3.0
"""mu at which the rebound is measured [J/kg]."""


class Params(StudyParams):
    """Parameters of study A2; mass and horizontal velocity are from the paper, so that q_x [m] equals the time [s]."""

    g: float = setting(9.81, "m/s^2", "gravity", above=0)
    q0: float = setting(1.0, "m", "height of the throw", above=0)
    m: float = setting(1.0, "kg", "mass", PAPER, above=0)
    v0: float = setting(1.0, "m/s", "horizontal velocity", PAPER, above=0)
    h: float = setting(0.01, "s", "step of time stepping; the paper's 1 s is unusable", above=0)
    duration: float = setting(1.0, "s", "time drawn", above=0)


def step_ball(params: Params, h: float, mu: float | None) -> tuple[np.ndarray, np.ndarray]:
    """Return height and vertical velocity (N+1,) under the exact law or, with ``mu`` [J/kg], the barrier law."""
    system = get("ball-bounce", h=h, g=params.g, m=params.m).system
    law = Exact() if mu is None else Barrier(mu=h * params.m * mu)
    start = np.array([[0.0, params.q0, params.v0, 0.0]])
    path, _ = SampledStep(law.close(system)).roll_out(start, np.zeros((1, 2)), round(params.duration / h))
    return path[0, :, 1], path[0, :, 3]


def run(params: Params) -> xr.Dataset:
    """Compute height, velocity and its derivative by q_x, for the laws and mu of fig. 2 of Zhang et al. 2023."""
    fine = np.linspace(0, params.duration, 4001)
    ode = [in_log_height(mu, params.q0, params.g, fine) for mu in MUS]
    steps = round(params.duration / params.h)
    time = params.h * np.arange(steps + 1)
    soft = [step_ball(params, params.h, mu) for mu in MUS]
    exact = step_ball(params, params.h, None)
    printed = as_printed(MUS[-1], params.q0, params.g, fine)[1]
    turns = [turning_points(mu, params.q0, params.g) for mu in MUS]
    regained = turning_points(REBOUND_MU, params.q0, params.g)[2]
    longer = params.model_copy(update={"duration": regained})
    # The rebound is the maximum after the minimum height.
    fallen = [step_ball(longer, h, REBOUND_MU)[0] for h in FINE]
    rebound = [float(y[int(y.argmin()) :].max()) for y in fallen]
    rates = [np.diff(v) / params.h / params.v0 for _, v in (*soft, exact)]
    per_mu, stepping = ("mu", "q_x"), ("mu", "q_step")
    energy = [v**2 / 2 + params.g * y - mu * np.log(y) for (y, v), mu in zip(ode, MUS, strict=True)]
    return dataset(
        {
            "y": (per_mu, [y for y, _ in ode], "m", "height, ODE"),
            "v": (per_mu, [v for _, v in ode], "m/s", "vertical velocity, ODE"),
            "rate": (
                per_mu,
                [(mu / y - params.g) / params.v0 for (y, _), mu in zip(ode, MUS, strict=True)],
                "1/s",
                "dv_y/dq_x, ODE",
            ),
            "y_step": (stepping, [y for y, _ in soft], "m", "height, time stepping"),
            "v_step": (stepping, [v for _, v in soft], "m/s", "velocity, time stepping"),
            "rate_step": (("mu", "q_mid"), rates[:-1], "1/s", "dv_y/dq_x, stepping"),
            "y_exact": ("q_step", exact[0], "m", "height, exact law"),
            "v_exact": ("q_step", exact[1], "m/s", "velocity, exact law"),
            "rate_exact": ("q_mid", rates[-1], "1/s", "dv_y/dq_x, exact law"),
            "printed_error": (
                (),
                np.abs(printed - ode[-1][1]).max(),
                "m/s",
                "(C.1) as printed less y'' = mu/y - g, largest mu",
            ),
            "energy_drift": ("mu", [np.ptp(e) / abs(e[0]) for e in energy], "1", "relative change of energy, ODE"),
            "least": ("mu", [low for low, _, _ in turns], "m", "least height, ODE"),
            "least_closed": (
                "mu",
                [least_height(mu, params.q0, params.g) for mu in MUS],
                "m",
                "least height, closed form",
            ),
            "apex": ("mu", [high for _, high, _ in turns], "m", "height regained, ODE"),
            "rebound": ("step", rebound, "m", "height regained by stepping, mu = 3"),
        },
        {
            "mu": (MUS, "J/kg", "central-path parameter of the force"),
            "q_x": (params.v0 * fine, "m", "horizontal position"),
            "q_step": (params.v0 * time, "m", "horizontal position"),
            "q_mid": (params.v0 * (time[1:] + time[:-1]) / 2, "m", "horizontal position between two nodes"),
            "step": (FINE, "s", "step size"),
        },
    )


def claims(data: xr.Dataset) -> list[Claim]:
    """Return the claims of Zhang et al. 2023, fig. 2, sec. 7.1 and sec. C.1."""
    g, q0, h = data.attrs["g"], data.attrs["q0"], data.attrs["h"]
    peak = data["rate"].values.max(axis=1)
    peak_step = data["rate_step"].values.max(axis=1)
    fall_time = np.sqrt(2 * q0 / g)
    fall = data["rate_exact"].values[data["q_mid"].values < fall_time - h] * data.attrs["v0"]
    velocity = data["v_exact"].values
    jump = float((velocity[2:] - velocity[:-2]).max())
    drift, apex = float(data["energy_drift"].max()), data["apex"].values
    rebound = data["rebound"].values
    resting_height = largest_value(data["y_exact"].values[data["q_step"].values > fall_time + 2 * h])
    least_height_error = np.abs(data["least"].values / data["least_closed"].values - 1).max()
    return [
        claim("In the exact LCS the velocity falls at -g and jumps at contact", "ABS, fig. 2")
        .expected(f"dv_y/dt = {-g:g}, then a jump")
        .measured(f"{fall.mean():.4f} m/s², jump {jump:.3f} m/s over two steps")
        .holds(np.allclose(fall, -g), jump > 0.9 * g * fall_time),
        claim("Larger mu makes the dynamics less stiff", "ABS, sec. 7.1")
        .expected("lower peak of dv/dq")
        .measured(format_values(peak, ".3g") + " 1/s")
        .below(np.diff(peak), 0),
        claim("The same by time stepping", "ABS, sec. 7.1")
        .expected("lower peak of dv/dq")
        .measured(format_values(peak_step, ".3g") + " 1/s")
        .below(np.diff(peak_step), 0),
        claim("(C.1) is the softened ball", "ABS, C.1")
        .expected("y'' = mu/y - g")
        .measured(f"{float(data['printed_error']):.1e} m/s apart at mu = {MUS[-1]:g}")
        .below(float(data["printed_error"]), 1e-6),
        claim("Solving (C.1) gives the behaviour of the LCS, which does not bounce", "our check")
        .expected(f"height regained {resting_height:.3g} m")
        .measured(f"{apex.min():.4f} to {apex.max():.4f} m: energy kept within {drift:.0e}")
        .below(apex, 0.1 * q0),
        claim("Least height is -(mu/g) W0(-(g/mu) exp(-E/mu))", "closed form")
        .expected("equal")
        .measured(f"within {least_height_error:.1e} relative")
        .below(least_height_error, 1e-6),
        claim("Time stepping at fixed mu tends to that elastic ball as h falls", "our check of C.1")
        .expected(f"{q0:g} m")
        .measured(format_values(rebound, ".2f") + f" m at h = {FINE[0]:g} to {FINE[-1]:g} s, mu = {REBOUND_MU:g}")
        .holds(np.diff(rebound) > 0, rebound[-1] > 0.9 * q0),
    ]
