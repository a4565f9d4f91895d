"""A mass with spring and damper in front of a wall at 0, with steps in closed form."""

from __future__ import annotations

import casadi as ca
import numpy as np

from dynamics.contact import Exact, Step
from dynamics.systems import ContactSystem, Parameter, ParameterTable, signals
from ocp.learning.explorer import Buffer
from ocp.problem.task import Task

H, M, K, D = 0.05, 2.0, 30.0, 1.5
NAMES = ["m", "k", "d"]


def exact_step() -> Step:
    """Return the step ``m (v+ - v) = h (u - k x - d v+) + lam``, ``x+ = x + h v+``, ``0 <= lam ⟂ x+ >= 0``."""
    p = ParameterTable(
        [
            Parameter("m", M, "kg"),
            Parameter("k", K, "N/m"),
            Parameter("d", D, "N s/m"),
            Parameter("rest", 0.0, "m"),
        ]
    )
    x, u, x_next, lam = ca.SX.sym("x", 2), ca.SX.sym("u"), ca.SX.sym("x_next", 2), ca.SX.sym("lam")
    force = u - p["k"] * (x[0] - p["rest"]) - p["d"] * x_next[1]
    system = ContactSystem(
        name="spring-mass",
        x=x,
        u=u,
        x_next=x_next,
        lam=lam,
        residual=ca.vertcat(x_next[0] - x[0] - H * x_next[1], p["m"] * (x_next[1] - x[1]) - H * force - lam),
        gap=x_next[0],
        states=signals("x [m]; v [m/s]"),
        inputs=signals("u [N]"),
        contacts=signals("wall [N s]"),
        h=H,
        parameters=p,
        phi=x[0],
        mu_per_kappa=H,
    )
    return Exact().close(system)


def following(x: np.ndarray, u: np.ndarray, m: float, k: float, d: float) -> np.ndarray:
    """Return the next states (n, 2) in closed form."""
    free = (m * x[:, 1] + H * (u[:, 0] - k * x[:, 0])) / (m + H * d)
    v = np.maximum(free, -x[:, 0] / H)
    return np.stack([x[:, 0] + H * v, v], axis=1)


def transitions(n: int, seed: int = 0, force: float = 20.0, noise: float = 0.0) -> Buffer:
    """Draw n transitions: states in front of the wall, forces up to ``force`` [N], and noise on the next velocity."""
    rng = np.random.default_rng(seed)
    x = np.stack([rng.uniform(0, 0.25, n), rng.uniform(-2, 2, n)], axis=1)
    u = rng.uniform(-force, force, (n, 1))
    found = following(x, u, M, K, D)
    found[:, 1] += noise * rng.standard_normal(n)
    return Buffer(x, u, found)


def spring_task(horizon: int = 6, far: float = 0.3) -> Task:
    """Return the task of moving to the wall: reward ``-x+² - 0.1 u²``, ended where x reaches ``far`` [m]."""
    system = exact_step().system
    x, u, chance = system.x, system.u, ca.SX.sym("chance", 2)
    return Task(
        name="spring-mass",
        system=system,
        parameters=system.parameters,
        horizon=horizon,
        start=ca.vertcat(0.15 + 0.1 * chance[0], chance[1]),
        chance=chance,
        reward=-(system.x_next[0] ** 2) - 0.1 * u[0] ** 2,
        observation=x,
        observations=system.states,
        lower=np.array([-2.0]),
        upper=np.array([6.0]),
        done=x[0] >= far,
    )
