"""The five dynamics of Suh et al. 2023, fig. 2, as contact laws, and gains learned through them."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import islice
from typing import ClassVar

import casadi as ca
import numpy as np

from dynamics.batch import StepFunction
from dynamics.contact import ContactLaw, Exact, Step
from dynamics.contact.closure import Branch, Closure
from dynamics.contact.learned_step import CasadiMap, LearnedStep
from dynamics.learned.laws import LearnedLaw
from dynamics.learned.transitions import Transitions
from dynamics.systems import ContactSystem, ParameterTable
from ocp import Direct, Feedback, NotConverged, SingleShooting, solve
from ocp.gradients.rollouts import RolloutObjective
from ocp.learning.unrolling import adam
from ocp.problem.evaluation import Evaluation
from ocp.problem.problem import Problem
from ocp.problem.rollout import Gains, roll_on
from problems.studies.shared.learned_laws import average_law, network_law

DYNAMICS = ("f", "f_sigma", "g_sigma", "h", "h_sigma")
"""Names of the dynamics: exact f, smoothed f_sigma, average g_sigma, networks h (clean) and h_sigma (noised)."""


@dataclass(eq=False)
class Bundle:
    """Averages of ``f(z + w)`` and ``f'(z + w)``, w ~ N(0, diag(width)²), over ``samples`` draws for each query z.

    Every evaluation uses new draws, in pairs w and -w, so that a slope is a random estimate of the slope of
    f_sigma (the paper's eq. 7). Draws for which the step has no solution are left out.
    """

    step: Step
    width: np.ndarray
    samples: int
    seed: int

    def __post_init__(self) -> None:
        self.n_out = self.step.system.nx
        self.n_in = self.n_out + self.step.system.nu
        self._f, self._rng = StepFunction(self.step), np.random.default_rng(self.seed)

    def values(self, z: np.ndarray) -> np.ndarray:
        """Return the mean next state (n, nx)."""
        return self.jacobians(z)[0]

    def jacobians(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the mean next state (n, nx) and the mean derivative (n, nx, nz)."""
        noise = self.width * self._rng.standard_normal((len(z), self.samples // 2, self.n_in))
        z_noised = (z[:, None] + np.concatenate([noise, -noise], axis=1)).reshape(-1, self.n_in)
        steps, *derivatives = self._f.derivatives(z_noised[:, : self.n_out], z_noised[:, self.n_out :])
        shape = len(z), -1, self.n_out
        slopes = np.concatenate(derivatives, axis=2).reshape(*shape, self.n_in)
        return np.nanmean(steps.x_next.reshape(shape), axis=1), np.nanmean(slopes, axis=1)

    def curvatures(self, z: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Raise ``NotImplementedError``, since second derivatives of the exact step are zero except at its kinks."""
        raise NotImplementedError("bundled gradients cannot be differentiated again; use Adam")


class Bundled(ContactLaw):
    """Contact law whose step is a :class:`Bundle`."""

    name: ClassVar[str] = "bundled"
    summary: ClassVar[str] = "mean of exact steps at random states and inputs"

    def __init__(self, bundle: Bundle) -> None:
        self.bundle = bundle

    def parameters(self, system: ContactSystem) -> ParameterTable:
        """Return an empty table, since the law has no parameters."""
        return ParameterTable()

    def target(self, system: ContactSystem, z: ca.SX, F: ca.SX, p: ParameterTable) -> ca.SX:
        """Return an empty vector, since contact is solved for every draw."""
        return ca.SX(0, 1)

    def close_at_nodes(self, system: ContactSystem, law: Closure, p: ParameterTable, nodes: tuple[Branch, ...]) -> Step:
        """Return the step whose next state is the bundle's mean."""
        return LearnedStep(system, law, p, nodes, CasadiMap(self.bundle))


def make_law(
    kind: str, data: Transitions, sigma: float, epochs: int, seed: int, problem_step: Step, samples: int = 100
) -> ContactLaw:
    """Return the contact law of the dynamics ``kind``, with sigma in standard deviations of the data."""
    if kind == "f":
        return Exact()
    if kind == "f_sigma":
        return Bundled(Bundle(problem_step, sigma * data.normalisation.scale, samples, seed))
    if kind == "g_sigma":
        return average_law(data, sigma, seed)
    return network_law(data, sigma if kind == "h_sigma" else 0.0, seed, epochs)


EVERY = 10
"""Number of iterations of Adam between two records."""


def descend_gains(problem: Problem, law: ContactLaw, rate: float, iterations: int) -> dict[str, np.ndarray]:
    """Minimise the cost of Suh et al. 2023, eq. 14, over the gains K_t and k_t by Adam.

    K starts at 0, k at the start position of the actuator. Return the costs on the model and under the
    exact law at every tenth iteration, and states (N+1, nx) of the last policy under the exact law.
    """
    exact = RolloutObjective(problem, Exact(), Feedback())
    # For one rollout at a time interpreted graphs are faster than compiled arrays of one sample.
    backend = {} if isinstance(law, Exact) else {"backend": "casadi", "threads": 1}
    model = RolloutObjective(problem, law, Feedback(), **backend)
    steps = islice(adam(model.cost_and_gradient, model.theta, rate), iterations + 1)
    records = [
        (cost, exact.cost_and_gradient(theta)[0], theta) for i, (theta, cost) in enumerate(steps) if i % EVERY == 0
    ]
    planned, replayed, thetas = zip(*records, strict=True)
    states = replay_gains(problem, gains_of(problem, thetas[-1]))
    return {"model": np.array(planned), "exact": np.array(replayed), "states": states}


def gains_of(problem: Problem, theta: np.ndarray) -> Gains:
    """Return the gains K (N, nu, nx) and k (N, nu) from ``theta``, which lists the rows of K and k for each step."""
    nx, nu = problem.system.nx, problem.system.nu
    rows = theta.reshape(problem.N, nu * nx + nu)
    return Gains(rows[:, : nu * nx].reshape(-1, nu, nx), rows[:, nu * nx :])


def replay_gains(problem: Problem, gains: Gains) -> np.ndarray:
    """Return the states (N+1, nx) of a rollout with the given gains under the exact law."""
    return roll_on(Evaluation(problem, problem.parameters.defaults), gains)[0].x[0]


def by_ipopt(problem: Problem, law: ContactLaw) -> dict[str, np.ndarray]:
    """Return the costs of IPOPT's gains, on the model and under the exact law, and the number of iterations.

    The exact law is solved without a homotopy, which would start under another law. Costs are NaN if IPOPT does not
    converge.
    """
    settings = {"homotopy": False} if isinstance(law, Exact) else {}
    method = Direct() if isinstance(law, LearnedLaw) else SingleShooting()
    try:
        solution = solve(problem, law, method, Feedback(), settings=settings)
    except NotConverged:
        return {"costs": np.full(2, np.nan), "iterations": np.array(0)}
    costs = np.array([solution.cost, solution.audit.exact_cost])
    return {"costs": costs, "iterations": np.array(solution.iterations)}
