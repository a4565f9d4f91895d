"""A2: a bouncing ball, by the softened equation of motion and by time stepping."""

from __future__ import annotations

import numpy as np
import xarray as xr

from dynamics.contact import Barrier, Exact
from problems.registry import get
from problems.studies.bouncing_ball.ball_ode import (
    as_printed,
    in_log_height,
    least_height,
    turning_points,
)
from problems.studies.shared.sampled_step import SampledStep
from problems.studies.study import PAPER, StudyParams, quantity_of, setting

MUS = (1.0, 2.0, 3.0, 5.0)
FINE = (1e-2, 3e-3, 1e-3, 3e-4, 1e-4)
REBOUND_MU = 3.0


class Params(StudyParams):
    """Parameters of A2; mass and horizontal velocity are the paper's, so q_x is the time."""

    g: float = setting(9.81, "m/s^2", "gravity", above=0)
    q0: float = setting(1.0, "m", "height of the throw", above=0)
    m: float = setting(1.0, "kg", "mass", PAPER, above=0)
    v0: float = setting(1.0, "m/s", "horizontal velocity", PAPER, above=0)
    h: float = setting(0.01, "s", "step of time stepping; the paper's 1 s is unusable", above=0)
    duration: float = setting(1.0, "s", "time drawn", above=0)


def stepped(params: Params, h: float, mu: float | None) -> tuple[np.ndarray, np.ndarray]:
    """Height (N+1,) and vertical velocity (N+1,) by time stepping; the impulse has mu h m."""
    system = get("ball-bounce", h=h, g=params.g, m=params.m).system
    law = Exact() if mu is None else Barrier(mu=h * params.m * mu)
    start = np.array([[0.0, params.q0, params.v0, 0.0]])
    path, _ = SampledStep(law.close(system)).roll_out(
        start, np.zeros((1, 2)), round(params.duration / h)
    )
    return path[0, :, 1], path[0, :, 3]


def run(params: Params) -> xr.Dataset:
    """Height, velocity and its derivative along q_x for the laws and mu of fig. 2."""
    fine = np.linspace(0, params.duration, 4001)
    ode = [in_log_height(mu, params.q0, params.g, fine) for mu in MUS]
    steps = round(params.duration / params.h)
    time = params.h * np.arange(steps + 1)
    soft = [stepped(params, params.h, mu) for mu in MUS]
    exact = stepped(params, params.h, None)
    printed = as_printed(MUS[-1], params.q0, params.g, fine)[1]
    turns = [turning_points(mu, params.q0, params.g) for mu in MUS]
    regained = turning_points(REBOUND_MU, params.q0, params.g)[2]
    rebound = [_rebound(params, h, regained) for h in FINE]
    rates = [np.diff(v) / params.h / params.v0 for _, v in (*soft, exact)]
    per_mu, stepping = ("mu", "q_x"), ("mu", "q_step")
    energy = [v**2 / 2 + params.g * y - mu * np.log(y) for (y, v), mu in zip(ode, MUS, strict=True)]
    return xr.Dataset(
        {
            "y": quantity_of(per_mu, [y for y, _ in ode], "m", "height, ODE"),
            "v": quantity_of(per_mu, [v for _, v in ode], "m/s", "vertical velocity, ODE"),
            "rate": quantity_of(per_mu, [(mu / y - params.g) / params.v0
                                         for (y, _), mu in zip(ode, MUS, strict=True)], "1/s",
                                "dv_y/dq_x, ODE"),
            "y_step": quantity_of(stepping, [y for y, _ in soft], "m", "height, time stepping"),
            "v_step": quantity_of(stepping, [v for _, v in soft], "m/s", "velocity, time stepping"),
            "rate_step": quantity_of(("mu", "q_mid"), rates[:-1], "1/s", "dv_y/dq_x, stepping"),
            "y_exact": quantity_of("q_step", exact[0], "m", "height, exact law"),
            "v_exact": quantity_of("q_step", exact[1], "m/s", "velocity, exact law"),
            "rate_exact": quantity_of("q_mid", rates[-1], "1/s", "dv_y/dq_x, exact law"),
            "printed_error": quantity_of((), np.abs(printed - ode[-1][1]).max(), "m/s",
                                         "(C.1) as printed less y'' = mu/y - g, largest mu"),
            "energy_drift": quantity_of("mu", [np.ptp(e) / abs(e[0]) for e in energy], "1",
                                        "relative change of energy, ODE"),
            "least": quantity_of("mu", [low for low, _, _ in turns], "m", "least height, ODE"),
            "least_closed": quantity_of("mu", [least_height(mu, params.q0, params.g)
                                               for mu in MUS], "m", "least height, closed form"),
            "apex": quantity_of("mu", [high for _, high, _ in turns], "m", "height regained, ODE"),
            "rebound": quantity_of("step", rebound, "m", "height regained by stepping, mu = 3"),
        },
        {
            "mu": quantity_of("mu", MUS, "J/kg", "central-path parameter of the force"),
            "q_x": quantity_of("q_x", params.v0 * fine, "m", "horizontal position"),
            "q_step": quantity_of("q_step", params.v0 * time, "m", "horizontal position"),
            "q_mid": quantity_of("q_mid", params.v0 * (time[1:] + time[:-1]) / 2, "m",
                                 "horizontal position between two nodes"),
            "step": quantity_of("step", FINE, "s", "step size"),
        },
    )  # fmt: skip


def _rebound(params: Params, h: float, duration: float) -> float:
    """Return the greatest height after the least one, by softened time stepping."""
    y, _ = stepped(params.model_copy(update={"duration": duration}), h, REBOUND_MU)
    return float(y[int(y.argmin()) :].max())
