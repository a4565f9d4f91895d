"""Cost of a plan or policy in another simulator, and its dependence on contact settings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from itertools import product
from typing import Any

import numpy as np

from dynamics.settings import read_value
from ocp.errors import choose
from ocp.problem.evaluation import Evaluation
from ocp.problem.problem import Problem
from ocp.problem.rollout import StateFeedback
from ocp.simulators import SIMULATORS
from ocp.simulators.mujoco_world import SOLREF_S, STEP_S, MujocoWorld

KEPT_COST_SHARE = 0.2
"""Relative change of a plan's cost up to which a simulator confirms it, without parts that no plan can change."""
SOLREF_BAND_S = (0.005, 0.04)
"""Time constants of hard and soft contact [s]."""
STEP_BAND_S = (5e-4, 2e-3)
"""Short and long step sizes [s]."""

SHORTEST_S = 1e-6
"""Smallest time constant of contacts and step [s]; a shorter step takes minutes for each step of a plan."""
REPLAY_SETTINGS = {"solref": SOLREF_S, "h": STEP_S}
"""Mapping from settings of a replay in MuJoCo to their defaults: time constant of contacts [s] and longest step [s].

``ocp gradients @last --world mujoco -s solref=0.005`` says at which of them gradients through contact are right."""


@dataclass(frozen=True)
class ExternalReplay:
    """Replay of a plan or policy in another simulator, at the time constant ``solref`` [s] and the step ``h`` [s].

    ``cost`` is the mean over scenarios in the simulator, NaN if the motion diverges, and
    ``planned_cost`` the plan's cost; ``keeps`` is true if the two agree within 20 %. ``band`` is the
    smallest and the largest cost over hard and soft contact and short and long steps.
    """

    world: str
    cost: float
    planned_cost: float
    keeps: bool
    band: tuple[float, float]
    solref: float = SOLREF_S
    h: float = STEP_S

    @property
    def sentence(self) -> str:
        """Sentence that compares the cost in the simulator with the plan's, with its range over contact settings."""
        if not np.isfinite(self.cost):
            return "In MuJoCo: the motion diverges."
        verb, (low, high) = "keeps" if self.keeps else "does not keep", self.band
        band = f"the cost is {low:.6g} to {high:.6g}"
        band = band if np.isfinite(low + high) else "the motion diverges at times"
        is_usual = {"solref": self.solref, "h": self.h} == REPLAY_SETTINGS
        contact = "" if is_usual else f" at solref {self.solref:g} s and steps of {1e3 * self.h:g} ms"
        return (
            f"In MuJoCo{contact}: cost {self.cost:.6g} (plan {self.planned_cost:.6g}), {verb} its cost"
            f" within {100 * KEPT_COST_SHARE:g} %; over solref {SOLREF_BAND_S[0]:g} to {SOLREF_BAND_S[1]:g} s and steps"
            f" {1e3 * STEP_BAND_S[0]:g} to {1e3 * STEP_BAND_S[1]:g} ms {band}."
        )

    @property
    def document(self) -> dict[str, Any]:
        """Result and settings as a dict of plain data."""
        fields = asdict(self)
        settings = {"solref": fields.pop("solref"), "step": fields.pop("h")}
        return {**fields, "settings": {**settings, "solrefs": SOLREF_BAND_S, "steps": STEP_BAND_S}}


def replay_in_simulator(
    name: str,
    problem: Problem,
    inputs: np.ndarray | StateFeedback,
    values: Mapping[str, float],
    x0: np.ndarray,
    planned_cost: float,
    settings: Mapping[str, Any] | None = None,
) -> ExternalReplay:
    """Return the replay of ``inputs`` (S, N, nu), or a policy, from x0 (S, nx) in the simulator ``name``.

    ``settings`` are those of :data:`REPLAY_SETTINGS` that differ from their defaults.

    Raises :class:`~ocp.errors.InputError` for an unknown simulator or setting, for a setting below :data:`SHORTEST_S`,
    and as :class:`~ocp.simulators.mujoco_world.MujocoWorld` does.
    """
    choose("world", name, SIMULATORS)
    for key in settings or {}:
        choose("setting of mujoco", key, REPLAY_SETTINGS)
    contact = {
        key: read_value(key, value, float, least=SHORTEST_S)
        for key, value in {**REPLAY_SETTINGS, **(settings or {})}.items()
    }
    solref, h = contact["solref"], contact["h"]
    simulator, evaluation = MujocoWorld(problem, values), Evaluation(problem, dict(values))

    def cost(solref: float, step: float) -> float:
        return float(simulated_costs(simulator, evaluation, inputs, x0, solref, step).mean())

    costs = [cost(solref, h), *(cost(*pair) for pair in product(SOLREF_BAND_S, STEP_BAND_S))]
    keeps = evaluation.cost_share(abs(costs[0] - planned_cost), planned_cost) <= KEPT_COST_SHARE
    return ExternalReplay(name, costs[0], planned_cost, keeps, (float(np.min(costs)), float(np.max(costs))), solref, h)


def simulated_costs(
    simulator: MujocoWorld,
    evaluation: Evaluation,
    inputs: np.ndarray | StateFeedback,
    x0: np.ndarray,
    solref: float = SOLREF_S,
    step: float = STEP_S,
) -> np.ndarray:
    """Return the costs (S,) of ``inputs`` (S, N, nu), or a policy, from x0 (S, nx) in MuJoCo; NaN after divergence."""
    x, u = simulated_motion(simulator, evaluation, inputs, x0, solref, step)
    return evaluation.trajectory_costs(x, u, np.zeros((*u.shape[:2], simulator.problem.system.nlam)))


def simulated_motion(
    simulator: MujocoWorld,
    evaluation: Evaluation,
    inputs: np.ndarray | StateFeedback,
    x0: np.ndarray,
    solref: float = SOLREF_S,
    step: float = STEP_S,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the states (S, N+1, nx) and the inputs (S, N, nu) of :func:`simulated_costs`."""
    lower, upper = evaluation.limits[2:4]
    S, problem = len(x0), simulator.problem
    N, system = problem.N, problem.system
    x, u = np.empty((S, N + 1, system.nx)), np.empty((S, N, system.nu))
    x[:, 0] = x0
    for s, k in np.ndindex(S, N):
        u[s, k] = inputs[s, k] if isinstance(inputs, np.ndarray) else np.clip(inputs.input(k, x[s, k]), lower, upper)
        x[s, k + 1] = simulator.step(x[s, k], u[s, k], solref, step)
    return x, u
