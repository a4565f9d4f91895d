"""The one judge: trajectories of any solver, held to one tolerance and to the certificate of ``ocp solve``."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from ocp.judge.certificate import certify
from ocp.problem.problem import Problem
from ocp.programs.program import PENALTY
from ocp.solve.solve import new_session
from tests.benchmarks.arena.peers import Answer

TOLERANCE = 1e-6
"""Largest residual of steps, constraints and bounds, and largest product of a pair, of a feasible answer [SI]."""


@dataclass(frozen=True)
class Verdict:
    """Cost without penalties, largest residual, largest product of a pair, and stationarity of an answer."""

    cost: float
    residual: float
    product: float
    stationarity: str

    @property
    def feasible(self) -> bool:
        """Whether the answer satisfies the task to the tolerance."""
        return max(self.residual, self.product) <= TOLERANCE

    @property
    def solved(self) -> bool:
        """Whether the answer is feasible and certified."""
        return self.feasible and self.stationarity in ("B", "KKT")


def judged(problem: Problem, answer: Answer) -> Verdict:
    """Return the verdict on states, inputs and multipliers, with the gaps that the system has there."""
    session = new_session(problem, contact="exact")
    nlp, values = session.nlp_of("none"), {**session.values, PENALTY: 0.0}
    p, bounds, gaps = nlp.parameter_vector(values), nlp.bounds(values), gaps_of(problem, answer)
    blocks = {"x": answer.x[1:], "u": answer.u, "lam": answer.lam, "gap": gaps}
    x = nlp.variables.pack({name: block[None] for name, block in blocks.items()})
    _, g = nlp.values(x, p)
    sides = (bounds["lbx"] - x, x - bounds["ubx"], bounds["lbg"] - g, g - bounds["ubg"])
    residual = max(float(np.max(side, initial=0.0)) for side in sides)
    product = float(np.max(np.abs(answer.lam * gaps), initial=0.0))
    stationarity = certify(nlp, x, p, bounds).stationarity if max(residual, product) <= TOLERANCE else "none"
    return Verdict(cost_of(problem, answer), residual, product, stationarity)


def gaps_of(problem: Problem, answer: Answer) -> np.ndarray:
    """Return the gaps (N, nlam) of the system at an answer."""
    gap = ca.Function("gap", problem.step_symbols, [ca.densify(problem.system.gap)]).map(problem.N)
    p = np.tile(problem.parameters.values[:, None], (1, problem.N))
    return np.array(gap(answer.x[:-1].T, answer.u.T, answer.x[1:].T, answer.lam.T, p)).T


def cost_of(problem: Problem, answer: Answer) -> float:
    """Return the task's own cost of an answer, without penalties of a formulation."""
    p, terms = problem.parameters.values, problem.cost_terms
    steps = zip(answer.x[:-1], answer.u, answer.lam, strict=True)
    running = sum(float(terms(x, u, 0, lam, p)[0]) for x, u, lam in steps)
    return running + float(terms(answer.x[-1], 0, 0, 0, p)[1])
