"""Evaluate expressions of a system along trajectories."""

from __future__ import annotations

import casadi as ca
import numpy as np

from dynamics.contact import Step
from dynamics.systems import ContactSystem
from ocp.problem import Problem
from ocp.rollout import at_steps


class TrajectoryEvaluator:
    """Evaluates expressions in (x, u, x_next, lam, p) along trajectories, each (S, N, size).

    The system is the problem's or its sharpest. Trajectories are x (S, N+1, nx), u (S, N, nu), lam
    (S, N, nlam); ``physical`` the values of the problem's parameters.
    """

    def __init__(self, problem: Problem, system: ContactSystem, x: np.ndarray, u: np.ndarray,
                 lam: np.ndarray, physical: np.ndarray) -> None:  # fmt: skip
        self.symbols = [system.x, system.u, system.x_next, system.lam, problem.parameters.vector]
        self.values, self.physical = (x[:, :-1], u, x[:, 1:], lam), physical

    def __call__(self, *expressions: ca.SX) -> list[np.ndarray]:
        """Evaluate the expressions at every scenario and step."""
        outputs = [ca.densify(expression) for expression in expressions]
        function = ca.Function("along", self.symbols, outputs)
        return at_steps(function, *self.values, p=self.physical)


def mean_multipliers(step: Step, lam: np.ndarray) -> np.ndarray:
    """Multipliers (S, N, nlam), averaged over a law's branches by their weights.

    NaN where the law has none, though the system has contacts: a learned law knows no forces.
    """
    if step.n < step.system.nlam:
        return np.full((*lam.shape[:2], step.system.nlam), np.nan)
    weights = np.array([node.weight for node in step.nodes])
    branches = lam.reshape(*lam.shape[:2], len(weights), step.system.nlam)
    return np.einsum("snbl,b->snl", branches, weights)


def distances(problem: Problem, x: np.ndarray, physical: np.ndarray) -> np.ndarray:
    """True signed distances phi at states x (..., nx) of a system with geometry, (..., n_phi)."""
    phi = problem.signed_distance
    assert phi is not None
    states = x.reshape(-1, x.shape[-1])
    found = phi.map(len(states))(states.T, physical)
    return np.array(found).T.reshape(*x.shape[:-1], -1)


def normal_impulses(
    problem: Problem, step: Step, x: np.ndarray, u: np.ndarray, lam: np.ndarray,
    physical: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """Normal impulse [N s] of every contact, (S, N, contacts), in the order of the first ``phi``.

    A multiplier that is a force [N] stays one.
    """
    system, mean = step.system, mean_multipliers(step, lam)
    if system.forces is not None:
        return TrajectoryEvaluator(problem, system, x, u, mean, physical)(system.forces.normal)[0]
    return mean[:, :, [i for i, pair in enumerate(system.pairs) if pair.kind == "normal"]]
