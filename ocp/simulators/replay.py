"""What a plan, or a policy, costs in another world, and how much that hangs on its settings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from itertools import product
from typing import Any

import numpy as np

from ocp.errors import choose
from ocp.problem.evaluation import Evaluation
from ocp.problem.problem import Problem
from ocp.problem.rollout import Gains
from ocp.simulators import WORLDS
from ocp.simulators.mujoco_world import SOLREF, STEP, MujocoWorld

KEPT = 0.2
"""By which share of its cost, or of the characteristic one, a plan may differ that keeps it."""
SOLREFS, STEPS = (0.005, 0.04), (5e-4, 2e-3)
"""Ends of the band: time constants of contact, and steps [s]."""


@dataclass(frozen=True)
class InWorld:
    """A plan, or a policy, in another world.

    ``cost`` is its mean over scenarios there, NaN where the motion diverges, ``planned_cost`` the
    plan's, and ``keeps`` says whether they agree within 20 %. ``band`` are the least and the
    largest cost over hard and soft contact and short and long steps.
    """

    world: str
    cost: float
    planned_cost: float
    keeps: bool
    band: tuple[float, float]

    @property
    def sentence(self) -> str:
        """All in a sentence."""
        if not np.isfinite(self.cost):
            return "In MuJoCo: the motion diverges."
        word, (low, high) = "keeps" if self.keeps else "does not keep", self.band
        band = f"the cost is {low:.6g} to {high:.6g}"
        band = band if np.isfinite(low + high) else "the motion diverges at times"
        return (
            f"In MuJoCo: cost {self.cost:.6g} (plan {self.planned_cost:.6g}), {word} its cost"
            f" within {100 * KEPT:g} %; over solref {SOLREFS[0]:g} to {SOLREFS[1]:g} s and steps"
            f" {1e3 * STEPS[0]:g} to {1e3 * STEPS[1]:g} ms {band}."
        )

    @property
    def document(self) -> dict[str, Any]:
        """All as plain data, and the settings."""
        settings = {"solref": SOLREF, "step": STEP, "solrefs": SOLREFS, "steps": STEPS}
        return {**asdict(self), "settings": settings}


def in_world(
    name: str,
    problem: Problem,
    inputs: np.ndarray | Gains,
    values: Mapping[str, float],
    x0: np.ndarray,
    planned_cost: float,
) -> InWorld:
    """Roll ``inputs`` (S, N, nu), or gains, out from x0 (S, nx) in the world ``name``.

    Raises :class:`~ocp.errors.InputError` for an unknown one, and as
    :class:`~ocp.simulators.mujoco_world.MujocoWorld` does.
    """
    choose("world", name, WORLDS)
    world, evaluation = MujocoWorld(problem, values), Evaluation(problem, dict(values))
    low, high = evaluation.limits[2:4]
    S, N, system = len(x0), problem.N, problem.system

    def cost(solref: float, step: float) -> float:
        x, u = np.empty((S, N + 1, system.nx)), np.empty((S, N, system.nu))
        x[:, 0] = x0
        for s, k in np.ndindex(S, N):
            if isinstance(inputs, Gains):
                u[s, k] = np.clip(inputs.input(k, x[s, k]), low, high)
            else:
                u[s, k] = inputs[s, k]
            x[s, k + 1] = world.ahead(x[s, k], u[s, k], solref, step)
        return float(evaluation.trajectory_costs(x, u, np.zeros((S, N, system.nlam))).mean())

    costs = [cost(SOLREF, STEP), *(cost(*pair) for pair in product(SOLREFS, STEPS))]
    keeps = evaluation.cost_share(abs(costs[0] - planned_cost), planned_cost) <= KEPT
    return InWorld(name, costs[0], planned_cost, keeps, (float(np.min(costs)), float(np.max(costs))))
