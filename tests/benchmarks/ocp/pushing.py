"""A box pushed round an obstacle with a sliding pusher: ``python -m tests.benchmarks.ocp.pushing``.

Fifty instances of one problem, with random obstacle, start and size, are solved cold as exact MPCC
of 100 steps: seconds, iterations, certificates. A peer's median on its own computer is 434 ms,
98 of 100 solved (``pushing_1_obs`` of InteriorPointDDP.jl; duration and goal are its own).
"""

from __future__ import annotations

import math
import sys
import time
import warnings
from statistics import median

import casadi as ca
import numpy as np

from dynamics.systems import ContactSystem, Parameter, ParameterTable, signals
from dynamics.systems.pairs import RefereeModel
from ocp import solve
from ocp.problem.problem import Constraint, Problem, Scaling

N, H, LIMIT, DAMPING = 100, 0.04, 0.4, 0.05
"""Steps, step size [s], largest force [N], and the damper [N s/rad]."""


def sliding_pusher(values: dict[str, float]) -> Problem:
    """Return a quasi-static box of half sides ``a``, ``b``, pushed from behind at the angle phi (Hogan).

    Forces n, t on the box give ``x' = R (n, t)``, ``theta' = (-a t + n a tan phi) / reach²``. A force
    c pulls the pusher along the side through a damper, ``t = c - d phi'``, and it sticks within the
    friction cone: ``phi' = plus - minus``, ``0 <= plus ⟂ mu n - c + d plus >= 0``,
    ``0 <= minus ⟂ mu n + c + d minus >= 0``.
    """
    table = ParameterTable([Parameter(name, value, "1") for name, value in values.items()])
    x, x_next, u, lam = (ca.SX.sym(s, k) for s, k in (("x", 4), ("x_next", 4), ("u", 2), ("lam", 2)))
    slid = lam[0] - lam[1]
    n, t = u[0], u[1] - DAMPING * slid
    a, mu, reach = table["a"], table["mu"], table["reach"]
    cos, sin = ca.cos(x[2]), ca.sin(x[2])
    moment = -a * t + n * a * ca.tan(x[3])
    rate = ca.vertcat(cos * n - sin * t, sin * n + cos * t, moment / reach**2, slid)
    system = ContactSystem(
        name="pushing",
        x=x,
        u=u,
        x_next=x_next,
        lam=lam,
        residual=x_next - x - H * rate,
        gap=mu * n + ca.vertcat(-u[1], u[1]) + DAMPING * lam,
        states=signals("x [m]; y [m]; theta [rad]; phi [rad]"),
        inputs=signals("n [N] normal force; c [N] force along the side"),
        contacts=signals("plus [rad/s] sliding up; minus [rad/s] sliding down"),
        h=H,
        parameters=table,
        gap_unit="N",
        referee_model=RefereeModel(),
        refinable=True,
    )
    away = x - ca.DM([0.3, 0.4, 1.5 * math.pi, 0.0])
    clear = ca.sumsqr(x[:2] - ca.vertcat(table["ox"], table["oy"])) - table["r"] ** 2
    return Problem(
        "pushing",
        system,
        N,
        stage_cost=1e-2 * ca.sumsqr(u) + 1e-3 * ca.sumsqr(lam),
        terminal_cost=100 * ca.sumsqr(away * ca.DM([1, 1, 0.3, 0])),
        x0=ca.vertcat(table["x0"], table["y0"], table["theta0"], 0.0),
        parameters=table,
        u_lower=ca.SX([0.0, -LIMIT]),
        u_upper=ca.SX([LIMIT, LIMIT]),
        x_lower=ca.SX([-np.inf, -np.inf, -np.inf, -0.9]),
        x_upper=ca.SX([np.inf, np.inf, np.inf, 0.9]),
        path=[Constraint("clear", clear, 0.0, ca.inf)],
        scaling=Scaling(impulse=1.0, gap=0.1, x=0.3, u=0.1),
    )


def drawn(rng: np.random.Generator) -> dict[str, float]:
    """Draw the parameters of one instance."""
    return {
        "a": rng.uniform(0.04, 0.07),
        "mu": rng.uniform(0.2, 0.5),
        "reach": 0.05,
        "ox": rng.uniform(0.1, 0.2),
        "oy": rng.uniform(0.15, 0.3),
        "r": rng.uniform(0.05, 0.1),
        "x0": rng.uniform(-0.05, 0.0),
        "y0": rng.uniform(-0.05, 0.05),
        "theta0": rng.uniform(-0.2, 0.2),
    }


def main(count: int = 50, strategy: str = "") -> None:
    """Print a line for each instance, and the medians."""
    warnings.simplefilter("ignore")
    rng, seconds, iterations, certified = np.random.default_rng(0), [], [], 0
    settings = {"strategy": strategy} if strategy else {}
    for k in range(count):
        problem = sliding_pusher(drawn(rng))
        began = time.perf_counter()
        found = solve(problem, contact="exact", settings=settings)
        seconds.append(time.perf_counter() - began)
        iterations.append(found.iterations)
        certified += found.certificate.certified
        kind, end = found.certificate.stationarity, found.data["x"].values[0, -1].round(3)
        print(
            f"{k:>3} {found.cost:>9.5f} {iterations[-1]:>6} {seconds[-1]:>6.2f} s {kind:<10}"
            f"{found.referee.word:<22}{end}",
            flush=True,
        )
    print(f"median {median(seconds):.2f} s, {median(iterations):.0f} iterations, certified {certified} of {count}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 50, *sys.argv[2:3])
