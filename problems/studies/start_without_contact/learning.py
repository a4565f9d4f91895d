"""Gains learned by Adam, or found by IPOPT, through each of the five dynamics."""

from __future__ import annotations

from itertools import islice

import numpy as np

from dynamics.contact import ContactLaw, Exact
from dynamics.learned.laws import LearnedLaw
from ocp import Direct, Feedback, NotConverged, SingleShooting, solve
from ocp.gradients.rollout_objective import RolloutObjective
from ocp.learning.adam import adam
from ocp.problem import Problem
from ocp.rollout import Gains, roll_on

EVERY = 10
"""Iterations of Adam from one record to the next."""


def descend(
    problem: Problem, law: ContactLaw, rate: float, iterations: int
) -> dict[str, np.ndarray]:
    """Minimise noising, eq. 14, over K_t and k_t from K = 0, k the actuator's start.

    Costs on the model and under the exact law, recorded every tenth iteration and at the end, and
    the last policy's states under the exact law (N+1, nx).
    """
    exact = RolloutObjective(problem, Exact(), Feedback())
    # One rollout at a time: interpreted graphs lose less than arrays of one sample do.
    own = {} if isinstance(law, Exact) else {"backend": "casadi", "threads": 1}
    model = RolloutObjective(problem, law, Feedback(), **own)
    steps = islice(adam(model.slope, model.theta, rate), iterations + 1)
    kept = [(cost, exact.slope(theta)[0], theta)
            for i, (theta, cost) in enumerate(steps) if i % EVERY == 0]  # fmt: skip
    planned, replayed, thetas = zip(*kept, strict=True)
    states = replay(problem, gains_of(problem, thetas[-1]))
    return {"model": np.array(planned), "exact": np.array(replayed), "states": states}


def gains_of(problem: Problem, theta: np.ndarray) -> Gains:
    """K (N, nu, nx) and k (N, nu) from the rows of both, step after step."""
    nx, nu = problem.system.nx, problem.system.nu
    rows = theta.reshape(problem.N, nu * nx + nu)
    return Gains(rows[:, : nu * nx].reshape(-1, nu, nx), rows[:, nu * nx :])


def replay(problem: Problem, gains: Gains) -> np.ndarray:
    """States (N+1, nx) of a policy under the exact law."""
    return roll_on(problem, gains, problem.parameters.defaults)[0].x[0]


def by_ipopt(problem: Problem, law: ContactLaw) -> dict[str, np.ndarray]:
    """Cost on the model and under the exact law of gains that IPOPT finds, and its iterations.

    The exact law is given no homotopy, which would begin under another law. NaN where there is no
    answer.
    """
    settings = {"homotopy": False} if isinstance(law, Exact) else {}
    method = Direct() if isinstance(law, LearnedLaw) else SingleShooting()
    try:
        found = solve(problem, law, method, Feedback(), settings=settings)
    except NotConverged:
        return {"costs": np.full(2, np.nan), "iterations": np.array(0)}
    costs = np.array([found.cost, found.audit.exact_cost])
    return {"costs": costs, "iterations": np.array(found.iterations)}
